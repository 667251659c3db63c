"""What must be the same on every side of a run for its bits to be the same."""

from __future__ import annotations

import hashlib
import platform
import re
from functools import cache
from importlib import metadata
from pathlib import Path

from env import plugins
from env.config import EnvConfig

PACKAGES = (
    *("agent", "client_app", "conf", "env", "lockstep"),
    *("repeatable", "server_app", "storage", "training"),
)


def fingerprint(config: EnvConfig | None = None) -> str:
    """What computes a run, in one line: our packages, torch, NumPy, the processor, plug-ins.

    Two sides with the same line compute the same weights from the same seed.

    Args:
        config: the run's environment, for the plug-ins that it uses; none if None.
    """
    return ", ".join([_installation(), *(plugins.identities(config) if config else ())])


@cache
def _installation() -> str:
    """The packages' content, torch, NumPy and the processor."""
    return (
        f"risfleet {version('risfleet')} ({_content()}), torch {version('torch')},"
        f" numpy {version('numpy')}, {_processor()}"
    )


def version(distribution: str) -> str:
    """The installed version of a distribution, or "unknown"."""
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return "unknown"


def _content() -> str:
    """A short digest of every source and configuration file of our packages."""
    root = Path(__file__).parent.parent
    digest = hashlib.sha256()
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*")):
            if path.suffix in (".py", ".yaml", ".toml"):
                digest.update(path.relative_to(root).as_posix().encode() + b"\0")
                digest.update(path.read_bytes() + b"\0")
    return digest.hexdigest()[:12]


def _processor() -> str:
    try:
        found = re.search(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.M)
    except OSError:
        found = None
    return found[1].strip() if found else (platform.processor() or platform.machine())
