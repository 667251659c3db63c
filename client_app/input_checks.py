"""Checks of what a robot receives, before it learns from it: a sound server sends none of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.networks.limits import WEIGHT_LIMIT, magnitude

RATE_LIMIT = 1024.0
"""In bit/s/Hz: log2 of no float64 is larger."""

CHANNEL_LIMIT_DB = 4000.0
"""Beyond 10 lg of the least and of the largest float64."""

FEW = 16
"""Records that are sooner checked one by one than all together."""

_FIELDS = ["cell", "outcome_cell", "rate", "channel_db", "outcome_channel_db"]


def check_received(tick: int, robots: Sequence[int], updates: np.ndarray, cells: int) -> None:
    """Checks the records of a step; a few microseconds for each robot, so before every tick.

    Args:
        tick: for the message.
        robots: whose each record is.
        updates: the records.
        cells: how many the floor has.

    Raises:
        ValueError: a cell that is not on the floor, or a rate or channel that is not a number or
            absurd; the message names tick, robot and value.
    """
    if len(updates) > FEW:  # of many, only those that something is wrong with are looked at
        rows = _suspects(updates, cells)
        robots, updates = [robots[row] for row in rows], updates[rows]
    for robot, received in zip(robots, updates[_FIELDS].tolist(), strict=True):
        cell, reached, rate, channel_db, reached_db = received
        if not (
            0 <= cell < cells
            and 0 <= reached < cells
            and 0.0 <= rate <= RATE_LIMIT
            and -CHANNEL_LIMIT_DB <= channel_db <= CHANNEL_LIMIT_DB
            and -CHANNEL_LIMIT_DB <= reached_db <= CHANNEL_LIMIT_DB
        ):
            values = ", ".join(
                f"{name}={value:g}" for name, value in zip(_FIELDS, received, strict=True)
            )
            raise ValueError(
                f"tick {tick}: robot {robot} received what cannot be ({values}): cells are 0 to"
                f" {cells - 1}, rates 0 to {RATE_LIMIT:g} bit/s/Hz, channels within"
                f" {CHANNEL_LIMIT_DB:g} dB of 0"
            )
    if "broadcast" in (updates.dtype.names or ()):
        for name in ("broadcast", "outcome_broadcast"):
            _check_finite(tick, robots, updates[name].sum(axis=-1), "a broadcast to")


def _suspects(updates: np.ndarray, cells: int) -> NDArray[np.intp]:
    """The rows in which a number is out of range."""
    sound = (updates["rate"] >= 0.0) & (updates["rate"] <= RATE_LIMIT)
    for name in ("cell", "outcome_cell"):
        sound &= (updates[name] >= 0) & (updates[name] < cells)
    for name in ("channel_db", "outcome_channel_db"):
        sound &= np.abs(updates[name]) <= CHANNEL_LIMIT_DB
    if "broadcast" in (updates.dtype.names or ()):
        for name in ("broadcast", "outcome_broadcast"):
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
    largest = magnitude(weights)
    if not largest <= WEIGHT_LIMIT:
        raise ValueError(
            f"window {window}: the global model holds absurd weights ({largest:.3g}): finite ones"
            f" of at most {WEIGHT_LIMIT:g} are taken"
        )
