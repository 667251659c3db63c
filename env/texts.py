"""Text files as editors leave them: UTF-8, with a byte order mark or without, any line ends."""

from __future__ import annotations

import codecs
from pathlib import Path

_OTHERS = {
    codecs.BOM_UTF32_LE: "UTF-32",  # begins as UTF-16's does, and so comes first
    codecs.BOM_UTF32_BE: "UTF-32",
    codecs.BOM_UTF16_LE: "UTF-16",
    codecs.BOM_UTF16_BE: "UTF-16",
}


def read_text(path: Path) -> str:
    r"""A text file that a user may have written or saved; lines end in ``\n``.

    Raises:
        OSError: it cannot be read.
        UnicodeError: it is not in UTF-8; the message says what it looks like and what to do.
    """
    content = path.read_bytes()
    for mark, name in _OTHERS.items():
        if content.startswith(mark):
            raise UnicodeError(f"it is in {name}: save it as UTF-8")
    if b"\0" in content:
        raise UnicodeError("it holds zero bytes, as UTF-16 does: save it as UTF-8")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        say = f"line {line} holds the byte 0x{content[error.start]:02x}, which is not UTF-8"
        raise UnicodeError(f"{say}: save it as UTF-8") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_unmarked_text(path: Path, reader: str) -> str:
    """As ``read_text``, for a file that another program reads, too, which knows no such marks."""
    text = read_text(path)
    if path.read_bytes().startswith(codecs.BOM_UTF8):
        say = f"it begins with a byte order mark, which {reader} does not read"
        raise UnicodeError(f"{say}: save it as UTF-8 without one")
    return text
