"""Disks that are full or cannot be written; root is stopped by neither permissions nor quotas."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tools.chaos.hosts import call

FILLER = "filler"


def obstacle() -> str:
    """Why this machine lets us mount nothing, empty if it does."""
    if sys.platform != "linux" or os.geteuid() != 0:
        return "mounts need root on Linux"
    if shutil.which("mount") is None:
        return "needs the command mount"
    tried = subprocess.run(["unshare", "--mount", "true"], capture_output=True, text=True)
    return f"mounts are not permitted here: {tried.stderr.strip()}" if tried.returncode else ""


@contextmanager
def small_disk(folder: Path, size: str = "4m") -> Iterator[None]:
    """A disk of that size at a folder, which is made; it is empty, and gone at the end."""
    folder.mkdir(parents=True)
    with _mounted(folder, "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)):
        yield


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """A folder with all that it holds that nobody can write to."""
    with _mounted(folder, "--bind", str(folder), str(folder)):
        call("mount", "-o", "remount,bind,ro", str(folder))
        yield


def fill(folder: Path) -> None:
    """Leaves no byte on a small disk."""
    with suppress(OSError), (folder / FILLER).open("wb", buffering=0) as file:
        while True:
            file.write(bytes(4096))


def free(folder: Path) -> None:
    """Takes back what `fill` did."""
    (folder / FILLER).unlink()


@contextmanager
def _mounted(folder: Path, *how: str) -> Iterator[None]:
    call("mount", *how)
    try:
        yield
    finally:
        call("umount", "--lazy", str(folder))
