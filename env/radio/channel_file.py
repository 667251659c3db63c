"""Channels from outside: a NumPy archive that ``env.channel.model=file`` reads (docs/channels.md).

It holds ``direct`` and ``reflected`` as a ``RadioMap`` does, the cells' centres and the units; and,
if its writer wants it checked, what of the environment the channels were made for.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import zipfile
import zlib
from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from env.arrays import Complexes
from env.config import EnvConfig
from env.geometry.floor import Floor
from env.plugins import PluginError, Tables
from env.validate import Problem

KEY = "env.channel.file"
UNITS = "amplitude, m"
"""Of channels, whose |h|^2 is the power gain, and of centres."""

ARRAYS = ("direct", "reflected", "cells_m", "units")
MADE_FOR = (
    "channel.frequency_ghz",
    "ap.position_m",
    "ris.position_m",
    "ris.side",
    "motion.antenna_height_m",
    "walls.segments",
)
"""What a file's channels depend on beside the cells, below ``env.``; compared where it says so."""

TOLERANCE_M = 1e-3
_DAMAGED = (
    ValueError, EOFError, OSError, RuntimeError, NotImplementedError, zipfile.BadZipFile, zlib.error
)  # fmt: skip


def write_channels(
    path: str | Path, config: EnvConfig, direct: Complexes, reflected: Complexes
) -> None:
    """Writes channels as a file that ``env.channel.model=file`` reads.

    Args:
        path: ends in ``.npz``.
        config: the environment that they were made for.
        direct: hbar at each cell's centre, shape (cells,), nowhere zero.
        reflected: c_n of each sub-surface at phase 0, shape (cells, N).

    Raises:
        ValueError: the tables are not what a run with that configuration needs.
    """
    floor = Floor.from_config(config)
    content = {
        "direct": direct,
        "reflected": reflected,
        "cells_m": floor.centres(),
        "units": np.array(UNITS),
        "made_for": np.array(json.dumps({key: attrgetter(key)(config) for key in MADE_FOR})),
    }
    _tables(str(path), content, config, floor)
    with Path(path).open("wb") as file:
        np.savez(file, **content)  # type: ignore[arg-type]


def read_channels(config: EnvConfig, floor: Floor) -> Tables:
    """The channels of the file that a configuration names, checked.

    Raises:
        PluginError: it cannot be read, is not the one that the run began with, or does not fit.
    """
    name = str(config.channel.file)
    try:
        data = Path(name).expanduser().read_bytes()
    except OSError as error:
        raise _refused(name, f"a file that can be read ({error.strerror})") from error
    found, wanted = hashlib.sha256(data).hexdigest(), config.channel.sha256
    if wanted not in (None, found):
        say = f"the file whose SHA-256 is {wanted}, with which the run began, and not {found}"
        raise _refused(name, say)
    return _tables(name, _content(name, data), config, floor)


def sha256_of(path: str | Path) -> str | None:
    """The digest of a file that can be read, in hexadecimal digits."""
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError:
        return None


def key_problems(config: EnvConfig) -> Iterator[Problem]:
    """Whether the keys of a file are set where a file is read, and there alone."""
    channel = config.channel
    if channel.model != "file":
        for key, value in (("file", channel.file), ("sha256", channel.sha256)):
            if value is not None:
                say = f"null with env.channel.model={channel.model}: only file reads it"
                yield f"env.channel.{key}", value, say
    elif channel.file is None:
        yield KEY, None, "the path of a file of channels with env.channel.model=file"
    elif channel.sha256 is not None and not re.fullmatch("[0-9a-f]{64}", channel.sha256):
        yield "env.channel.sha256", channel.sha256, "null, or 64 hexadecimal digits"


def problems(config: EnvConfig) -> list[Problem]:
    """What is wrong with the file, where one is named: its key, its path and what is allowed.

    It is read for that, so this is for whoever makes the radio map and not for robots' sides, which
    may be on machines without the file.
    """
    if config.channel.model != "file":
        return []
    try:
        read_channels(config, Floor.from_config(config))
    except PluginError as error:
        return [error.problem]
    return []


def _refused(name: str, allowed: str) -> PluginError:
    return PluginError(KEY, name, allowed)


def _content(name: str, data: bytes) -> dict[str, NDArray[Any]]:
    """The arrays of an archive."""
    if not zipfile.is_zipfile(io.BytesIO(data)):
        raise _refused(name, f"a NumPy archive (.npz), which these {len(data)} bytes are not")
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            found = {key: archive[key] for key in archive.files}
    except _DAMAGED as error:
        raise _refused(name, f"a whole NumPy archive of numbers and texts ({error})") from error
    if not all(isinstance(array, np.ndarray) for array in found.values()):
        raise _refused(name, "a NumPy archive whose members are arrays")
    return found


def _tables(name: str, content: dict[str, NDArray[Any]], config: EnvConfig, floor: Floor) -> Tables:
    """The two tables of an archive, if it is what it must be."""
    missing = [key for key in ARRAYS if key not in content]
    if missing:
        has = ", ".join(content) or "none"
        raise _refused(name, f"a file with the arrays {', '.join(ARRAYS)}, and not with {has}")
    if content["units"].shape != () or str(content["units"]) != UNITS:
        raise _refused(name, f"a file whose units are {UNITS!r}, and not {content['units']}")
    _check_cells(name, content["cells_m"], floor)
    if "made_for" in content:
        _check_made_for(name, str(content["made_for"]), config)
    surfaces = config.ris.subsurfaces
    direct = _table(name, "direct", content["direct"], (floor.cells,), "a channel for each cell")
    say = f"for each cell env.ris.subsurfaces={surfaces} channels"
    reflected = _table(name, "reflected", content["reflected"], (floor.cells, surfaces), say)
    if not np.abs(direct).all():
        cell = int(np.argmin(np.abs(direct)))
        raise _refused(name, f"a file whose direct is nowhere zero, and not in cell {cell}")
    return direct, reflected if config.ris.side else np.zeros_like(reflected)


def _check_cells(name: str, cells_m: NDArray[Any], floor: Floor) -> None:
    """Checks that the channels are those of the floor's cells, in their order."""
    centres = floor.centres()
    width_m, depth_m = floor.size_m
    own = f"{floor.cells} cells of the floor of {width_m:g} m x {depth_m:g} m"
    if cells_m.shape != centres.shape or not np.issubdtype(cells_m.dtype, np.floating):
        found = f"an array of {cells_m.dtype} of shape {cells_m.shape}"
        say = f"a file whose cells_m are x and y of the {own}, of shape {centres.shape}"
        raise _refused(name, f"{say}, and not {found}")
    apart = ~(np.abs(cells_m - centres) <= TOLERANCE_M).all(axis=1)
    if apart.any():
        cell = int(np.argmax(apart))
        (x, y), (own_x, own_y) = cells_m[cell], centres[cell]
        say = f"a file whose cells_m are the centres of the {own}, row by row from the origin"
        raise _refused(name, f"{say}: cell {cell} is at {own_x:g},{own_y:g}, and not {x:g},{y:g}")


def _check_made_for(name: str, text: str, config: EnvConfig) -> None:
    """Checks that what the channels were made for is what the environment has."""
    try:
        made_for = json.loads(text)
    except ValueError as error:
        raise _refused(name, f"a file whose made_for is JSON ({error})") from error
    if not isinstance(made_for, dict) or not set(made_for) <= {*MADE_FOR}:
        say = f"a file whose made_for is a mapping of some of {', '.join(MADE_FOR)}"
        raise _refused(name, f"{say}, and not {text}")
    for key, value in made_for.items():
        own = attrgetter(key)(config)
        without = (
            key.startswith("ris.") and not config.ris.side
        )  # no RIS: its channels do not count
        if value != own and not without:
            raise _refused(name, f"a file made for env.{key}={own}, and not for {value}")


def _table(
    name: str, which: str, table: NDArray[Any], shape: tuple[int, ...], meaning: str
) -> Complexes:
    """One of the tables, if it is what it must be."""
    if table.shape != shape:
        say = f"of shape {shape}, {meaning}, and not {table.shape}"
    elif not np.issubdtype(table.dtype, np.complexfloating):
        say = f"complex, and not {table.dtype}"
    elif not np.isfinite(table).all():
        cell = int(np.argwhere(~np.isfinite(table))[0][0])
        say = f"finite everywhere, and not {table[cell]} in cell {cell}"
    elif (np.abs(table) > 1.0).any():
        cell = int(np.argwhere(np.abs(table) > 1.0)[0][0])
        say = f"of amplitudes up to 1, as no link amplifies, and not {table[cell]} in cell {cell}"
    else:
        return np.array(table, dtype=np.complex128, order="C")
    raise _refused(name, f"a file whose {which} is {say}")
