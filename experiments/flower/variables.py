"""Which of the user's environment variables reach Flower's processes.

Those of a private session are chosen: what is listed here is passed on, and all else is left out,
since much of it leads Flower, Ray and their libraries elsewhere (a proxy, another's cluster, other
certificates) or changes what they print.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path

PASS = "RISFLEET_PASS"
"""The variable by which a user names further ones, with commas between them."""

CHOSEN = (
    # Who and where the user is.
    *("PATH", "HOME", "USER", "LOGNAME", "LNAME", "USERNAME", "SHELL", "TZ", "TZDIR"),
    *("LANG", "LANGUAGE", "LC_*", "LOCPATH", "LOCALE_ARCHIVE", "TMPDIR", "TMP", "TEMP", "XDG_*"),
    # Where Python, its packages (plug-ins among them) and their libraries are found.
    *("PYTHONPATH", "PYTHONHOME", "PYTHONUSERBASE", "PYTHONNOUSERSITE", "PYTHONPYCACHEPREFIX"),
    *("PYTHONDONTWRITEBYTECODE", "PYTHONUTF8", "PYTHONUNBUFFERED", "PYTHONHASHSEED"),
    *("PYTHONWARNINGS", "PYTHONFAULTHANDLER", "VIRTUAL_ENV", "CONDA_*"),
    *("LD_LIBRARY_PATH", "LD_PRELOAD", "DYLD_*", "NIX_LD*"),
    # How numbers are computed: every runtime must do so alike.
    *("OMP_*", "GOMP_*", "KMP_*", "MKL_*", "OPENBLAS_*", "GOTO_*", "BLIS_*", "NVPL_*", "NPY_*"),
    *("VECLIB_*", "NUMEXPR_*", "DNNL_*", "ONEDNN_*", "ATEN_*", "TORCH*", "PYTORCH_*"),
    *("MALLOC_*", "GLIBC_TUNABLES"),
    # Accelerators.
    *("CUDA_*", "CUBLAS_*", "CUDNN_*", "NCCL_*", "NVIDIA_*", "HIP_*", "HSA_*", "ROCR_*"),
    # Where trackers record a run, and as what.
    *("WANDB_*", "MLFLOW_*"),
    # What figures look like, what tests measure, what is ours, and what a user's plug-in reads.
    *("MPLCONFIGDIR", "MATPLOTLIBRC", "COVERAGE_*", "COV_CORE_*", "RISFLEET_*"),
)
"""Names and patterns of what is passed on."""

COLOURS = ("FORCE_COLOR", "CLICOLOR_FORCE", "TTY_COMPATIBLE", "TTY_INTERACTIVE", "PY_COLORS")
"""What makes commands colour their answers, which are then no JSON."""


def chosen(variables: Mapping[str, str] | None = None) -> dict[str, str]:
    """The variables that a process of a private session gets of the user's, or this process's.

    They are those that are listed or that the user has named, proxies left out in any case.
    """
    given = os.environ if variables is None else variables
    named = (name.strip() for name in given.get(PASS, "").split(","))
    patterns = (*CHOSEN, *filter(None, named))
    return {
        name: _from_anywhere(name, value)
        for name, value in given.items()
        if any(fnmatchcase(name, pattern) for pattern in patterns) and not is_proxy(name)
    }


def _from_anywhere(name: str, value: str) -> str:
    """A variable as processes need it that work in a folder of their own."""
    database = "sqlite:///"
    path = value.removeprefix(database)
    if name != "MLFLOW_TRACKING_URI" or path == value or path.startswith("/"):
        return value
    return f"{database}{Path.cwd() / path}"


def is_proxy(name: str) -> bool:
    """Whether a variable says by which proxy to go, or where not to: in any spelling."""
    return name.lower().endswith("_proxy")


def proxies() -> list[str]:
    """Names of this process's variables that lead through a proxy."""
    return sorted(
        name
        for name, value in os.environ.items()
        if is_proxy(name) and value and name.lower() != "no_proxy"
    )
