"""What a safetensors file says of itself: texts by name in its header, beside the arrays."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from safetensors import SafetensorError, safe_open

_LENGTH = 8
"""Bytes at the beginning that hold the header's length; the arrays begin at a multiple of it."""


def with_metadata(content: bytes, metadata: Mapping[str, str]) -> bytes:
    """A file's content with metadata, in the order given: the same bytes each time.

    The library writes metadata in another order each time.

    Args:
        content: what ``safetensors`` has made of arrays.
        metadata: texts by name, in place of those that are there.
    """
    end = _LENGTH + int.from_bytes(content[:_LENGTH], "little")
    arrays = {k: v for k, v in json.loads(content[_LENGTH:end]).items() if k != "__metadata__"}
    header = json.dumps({"__metadata__": {**metadata}, **arrays}, separators=(",", ":")).encode()
    header += b" " * (-len(header) % _LENGTH)
    return len(header).to_bytes(_LENGTH, "little") + header + content[end:]


def read_metadata(path: Path) -> dict[str, str]:
    """The metadata of a file; none if it has none, or is missing or damaged."""
    try:
        with safe_open(path, framework="np") as file:
            return file.metadata() or {}
    except (SafetensorError, OSError):
        return {}
