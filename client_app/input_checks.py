"""Checks of what a robot receives, before it learns from it: a sound server sends none of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.networks.limits import check_weights

RATE_LIMIT = 1024.0
"""In bit/s/Hz: log2 of no float64 is larger."""

CHANNEL_LIMIT_DB = 4000.0
"""Beyond 10 lg of the least and of the largest float64."""

FEW = 16
"""Records that are sooner checked one by one than all together."""

_FIELDS = ["cell", "outcome_cell", "rate", "channel_db", "outcome_channel_db"]
_BROADCASTS = ("broadcast", "outcome_broadcast")


def check_received(tick: int, robots: Sequence[int], updates: np.ndarray, cells: int) -> None:
    """Checks the robots' records of a step on a floor of so many cells.

    It takes a few microseconds for each robot, so it is done before every tick.

    Raises:
        ValueError: a cell that is not on the floor, or a rate or channel that is not a number or
            absurd; the message names tick, robot and value.
    """
    if len(updates) > FEW:  # of many, only those that something is wrong with are looked at
        rows = _suspects(updates, cells)
        robots, updates = [robots[row] for row in rows], updates[rows]
    bounds = _bounds(cells)
    for robot, received in zip(robots, updates[_FIELDS].tolist(), strict=True):
        pairs = zip(received, bounds, strict=True)
        if not all(least <= value <= most for value, (least, most) in pairs):
            given = zip(_FIELDS, received, strict=True)
            values = ", ".join(f"{name}={value:g}" for name, value in given)
            raise ValueError(
                f"tick {tick}: robot {robot} received what cannot be ({values}): cells are 0 to"
                f" {cells - 1}, rates 0 to {RATE_LIMIT:g} bit/s/Hz, channels within"
                f" {CHANNEL_LIMIT_DB:g} dB of 0"
            )
    for name in _broadcasts(updates):
        _check_finite(tick, robots, updates[name].sum(axis=-1), "a broadcast to")


def _bounds(cells: int) -> tuple[tuple[float, float], ...]:
    """The least and the most that each of the fields may be."""
    cell, channel_db = (0, cells - 1), (-CHANNEL_LIMIT_DB, CHANNEL_LIMIT_DB)
    return cell, cell, (0.0, RATE_LIMIT), channel_db, channel_db


def _broadcasts(updates: np.ndarray) -> tuple[str, ...]:
    """The fields of what the access point tells, if there are any."""
    return _BROADCASTS if "broadcast" in (updates.dtype.names or ()) else ()


def _suspects(updates: np.ndarray, cells: int) -> NDArray[np.intp]:
    """The rows in which a number is out of range."""
    sound = np.ones(len(updates), dtype=bool)
    for name, (least, most) in zip(_FIELDS, _bounds(cells), strict=True):
        sound &= (updates[name] >= least) & (updates[name] <= most)
    for name in _broadcasts(updates):
        sound &= np.isfinite(updates[name].sum(axis=-1))
    return np.flatnonzero(~sound)


def check_rewards(
    tick: int, robots: Sequence[int], reward: NDArray[np.float64], learning: NDArray[np.bool_]
) -> None:
    """Checks the rewards of the robots that learn from them.

    Raises:
        ValueError: one is not finite; the message names tick, robot and value.
    """
    _check_finite(tick, robots, np.where(learning, reward, 0.0), "the reward of")


def _check_finite(
    tick: int, robots: Sequence[int], values: NDArray[np.floating], what: str
) -> None:
    wrong = np.flatnonzero(~np.isfinite(values))
    if len(wrong):
        raise ValueError(f"tick {tick}: {what} robot {robots[wrong[0]]} is {values[wrong[0]]}")


def check_model(window: int, weights: NDArray[np.float32]) -> None:
    """Checks a global model before robots take it.

    Raises:
        ValueError: a weight is not finite or beyond ``WEIGHT_LIMIT``; the message names window and
            value.
    """
    check_weights(weights, f"window {window}: the global model holds absurd weights")
