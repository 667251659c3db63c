"""What processes of a private Flower session are given, and how they are started."""

from __future__ import annotations

import os
import subprocess
import sysconfig
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

SETTINGS = {
    "FLWR_TELEMETRY_ENABLED": "0",
    "FLWR_DISABLE_UPDATE_CHECK": "1",
    # Without it a SuperLink installs the dependencies anew for every run, torch included.
    "FLWR_DISABLE_RUNTIME_DEPENDENCY_INSTALLATION": "1",
    "RAY_USAGE_STATS_ENABLED": "0",
}


def with_scripts(environment: Mapping[str, str]) -> dict[str, str]:
    """An environment in which Flower finds its own commands, which it starts by bare names."""
    scripts = sysconfig.get_path("scripts")
    path = os.pathsep.join([scripts, environment.get("PATH", os.defpath)])
    return {**environment, "PATH": path}


def started_apart(
    argv: Sequence[str],
    folder: Path,
    environment: Mapping[str, str],
    output: IO[bytes] | int,
    errors: IO[bytes] | int = subprocess.STDOUT,
) -> subprocess.Popen[bytes]:
    """Starts a process in a folder, away from our terminal's signals.

    Args:
        argv: command and arguments.
        folder: where it works.
        environment: its variables.
        output: where its standard output goes.
        errors: where its standard error goes, by default to the same place.
    """
    return subprocess.Popen(
        argv,
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=errors,
        cwd=folder,
        env=environment,
        start_new_session=True,
    )
