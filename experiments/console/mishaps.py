"""What the system refused, in a sentence: the reason, and the file or else the place in the code.

A bare ``[Errno 32] Broken pipe`` tells nobody what to do.
"""

from __future__ import annotations

import errno
import os
import ssl
from pathlib import Path
from types import TracebackType

_ROOT = Path(__file__).parents[2]
_PACKAGES = (
    *("agent", "client_app", "conf", "env", "experiments"),
    *("lockstep", "repeatable", "risfleet", "server_app", "storage", "training"),
)
_ADVICE = {
    errno.ENOSPC: "make room there",
    errno.EDQUOT: "make room there",
    errno.EMFILE: "allow more with `ulimit -n`",
    errno.ENOMEM: "this machine has no memory left",
    errno.EAGAIN: "this machine has no processes or memory left; see `ulimit -u`",
    errno.EPIPE: "a process on this machine, or what reads the output, has ended",
}


def in_words(error: BaseException) -> str:
    """An error as a user reads it.

    Args:
        error: any; what is no error of the system speaks for itself.

    Returns:
        Its text; of a system's error the reason, then the file, or where it happened.
    """
    if not isinstance(error, OSError) or error.errno is None or isinstance(error, ssl.SSLError):
        return str(error) or f"{type(error).__name__}{_place(error.__traceback__)}"
    reason = error.strerror or os.strerror(error.errno)
    files = [_text(name) for name in (error.filename, error.filename2) if name is not None]
    if files:
        return f"{reason}: {' -> '.join(files)}"
    advice = f" ({_ADVICE[error.errno]})" if error.errno in _ADVICE else ""
    return f"{reason}{advice}{_place(error.__traceback__)}"


def _text(name: object) -> str:
    return os.fsdecode(name) if isinstance(name, bytes | os.PathLike) else str(name)


def _place(trace: TracebackType | None) -> str:
    """The innermost place of ours, empty if there is none."""
    place = ""
    while trace is not None:
        code = trace.tb_frame.f_code
        path = Path(code.co_filename)
        if path.is_relative_to(_ROOT) and path.relative_to(_ROOT).parts[0] in _PACKAGES:
            inside = path.relative_to(_ROOT)
            place = f", in {code.co_qualname} of {inside}, line {trace.tb_lineno}"
        trace = trace.tb_next
    return place
