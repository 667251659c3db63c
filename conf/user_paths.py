"""Paths as users write them on a command line: any that the file system takes, quoted or not."""

from __future__ import annotations

import os
import re
import shlex
from contextlib import suppress
from pathlib import Path

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.errors import HydraException

CHANNELS = "env.channel.file"
LISTED = ("env.plan", CHANNELS)
"""Keys whose values are paths, of which a sweep lists several with commas between them."""

PATHS = ("run.dir", *LISTED)
"""Keys of a run whose values are paths."""

RESUME = "resume"
"""Names the folder of a run that goes on; it is no key of a run."""

_FUNCTION = re.compile(r"(choice|glob|range|shuffle|sort)\(")
_VALUE = re.compile(r"""'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|[^,]+""")
"""One of several values with commas between them; a quoted one may hold some."""
_OVERRIDE = re.compile(r"(?P<key>\+{0,2}[\w.]+)=(?P<value>.*)", re.DOTALL)


def user_path(text: str) -> Path:
    """The path that a user means: ``~`` is expanded, and quotes around all of it are taken off.

    Args:
        text: an argument, or what stands behind ``KEY=``.
    """
    return Path(_expanded(text))


def with_quoted_path(text: str, *, several: bool = False) -> str:
    """An override whose path, if it holds one, is quoted, so that Hydra takes it as it is.

    Args:
        text: such as ``run.dir=/tmp/my run``; what sets no path comes back unchanged.
        several: whether commas of ``LISTED`` keys separate values.
    """
    found = _OVERRIDE.fullmatch(text)
    if found is None or found["key"].lstrip("+") not in PATHS or found["value"] == "null":
        return text
    values = [found["value"]]
    listed = found["key"].lstrip("+") in LISTED
    if several and listed and not user_path(found["value"]).exists():
        if _FUNCTION.match(found["value"]):
            return text
        values = _VALUE.findall(found["value"])
    return f"{found['key']}={','.join(quoted(_expanded(value)) for value in values)}"


def quoted(text: str) -> str:
    """A text as Hydra takes it as it is, but for interpolations."""
    return QuotedString(text, Quote.single).with_quotes()


def resumed_folder(text: str) -> Path | None:
    """The folder of ``resume=FOLDER``; None for any other override."""
    found = _OVERRIDE.fullmatch(text)
    return user_path(found["value"]) if found and found["key"].lstrip("+") == RESUME else None


def pasted(key: str, path: Path) -> str:
    """An override of a path as it can be pasted into a shell."""
    return shlex.quote(f"{key}={path}")


def _expanded(text: str) -> str:
    """``user_path`` as text, in which an empty one stays empty; Hydra reads the quotes."""
    if len(text) > 1 and text[0] in "'\"" and text[-1] == text[0]:
        with suppress(HydraException):
            value = OverridesParser.create().parse_override(f"x={text}").value()
            text = value if isinstance(value, str) else text
    return os.path.expanduser(text)
