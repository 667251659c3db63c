"""Files that a run is submitted with: the app's manifest, its configuration, the connection.

The app is submitted from a folder that holds nothing but a manifest; both components are imported
from the installation, so it works from any working folder and uploads no code.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from experiments.flower.environment import CONNECTION


@dataclass(frozen=True)
class Components:
    """Import references of an app's two parts, `module:attribute`."""

    server: str = "server_app.app:app"
    client: str = "client_app.app:app"


def write_manifest(folder: Path, components: Components) -> Path:
    """Writes the `pyproject.toml` of an app without code; returns the folder, for it alone."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "pyproject.toml").write_text(
        f"""[project]
name = "risfleet"
version = {_toml_string(version("risfleet"))}
description = "Manifest only: the code is the installed risfleet"
license = "Apache-2.0"
dependencies = []

[tool.flwr.app]
publisher = "risfleet"

[tool.flwr.app.components]
serverapp = {_toml_string(components.server)}
clientapp = {_toml_string(components.client)}

[tool.flwr.app.config]
overrides = ""
""",
        encoding="utf-8",
    )
    return folder


def write_run_config(path: Path, overrides: str) -> Path:
    """Writes the run's configuration: a file, since Flower splits a command line at blanks."""
    path.write_text(f"overrides = {_toml_string(overrides)}\n", encoding="utf-8")
    return path


def write_connection(home: Path, address: str, authority: Path | None = None) -> None:
    """Names a SuperLink on loopback in a Flower home, as its default connection.

    Args:
        home: Flower's.
        address: host and port.
        authority: the certificate by which the SuperLink is known; None without TLS.
    """
    known = "insecure = true"
    if authority is not None:
        known = f"root-certificates = {_toml_string(str(authority))}"
    (home / "config.toml").write_text(
        f'[superlink]\ndefault = "{CONNECTION}"\n\n[superlink.{CONNECTION}]\n'
        f"address = {_toml_string(address)}\n{known}\n",
        encoding="utf-8",
    )


def _toml_string(value: str) -> str:
    # JSON's escapes are TOML's, but TOML also wants DEL escaped.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
