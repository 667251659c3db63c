"""One thread of arithmetic per process.

The products of a DQN are so small that a second thread costs more than it gives (7 to 9 times
slower on a busy machine), and how work is split among threads may change the last bits.
"""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

import torch

_MEMORY_MAP = Path("/proc/self/maps")
_SETTERS = [
    f"{prefix}openblas_set_num_threads{suffix}"
    for prefix in ("scipy_", "")
    for suffix in ("64_", "")
]


def single_threaded() -> None:
    """Holds torch's and NumPy's linear algebra to one thread each; harmless when repeated."""
    if torch.get_num_threads() != 1:
        torch.set_num_threads(1)
    for library in _loaded_openblas():
        handle = ctypes.CDLL(library)
        for name in _SETTERS:
            if hasattr(handle, name):
                getattr(handle, name)(ctypes.c_int(1))


def _loaded_openblas() -> set[str]:
    """OpenBLAS builds in this process, as Linux tells; elsewhere none are found."""
    if not _MEMORY_MAP.exists():
        return set()
    return set(re.findall(r"(/\S*openblas\S*)$", _MEMORY_MAP.read_text(), flags=re.MULTILINE))
