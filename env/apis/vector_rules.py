"""What Gymnasium says of vector environments: autoreset modes, reset masks, seeds and infos."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from env.apis.fleet_infos import Columns
from env.arrays import Bools, Floats32

Infos = dict[str, Any]
MASK = "reset_mask"


def checked_mode(autoreset_mode: AutoresetMode | str) -> AutoresetMode:
    """The mode of that name.

    Raises:
        ValueError: there is none.
    """
    try:
        return AutoresetMode(autoreset_mode)
    except ValueError as error:
        allowed = ", ".join(mode.value for mode in AutoresetMode)
        raise ValueError(f"autoreset_mode={autoreset_mode!r}: allowed is {allowed}") from error


def reset_mask(
    options: Mapping[str, Any] | None, count: int
) -> tuple[Bools, Mapping[str, Any] | None]:
    """Which of the environments a reset begins anew, shape (count,), and the other options.

    Raises:
        ValueError: the mask is none.
    """
    if not isinstance(options, Mapping) or MASK not in options:
        return np.ones(count, dtype=bool), options
    mask = options[MASK]
    right = isinstance(mask, np.ndarray) and mask.dtype == bool
    if not right or mask.shape != (count,) or not mask.any():
        allowed = f"a bool array of shape ({count},) that is not all False"
        raise ValueError(f"options.{MASK}={mask!r}: allowed is {allowed}")
    return mask, {name: value for name, value in options.items() if name != MASK}


def seeds(seed: int | Sequence[int | None] | None, count: int) -> Sequence[int | None]:
    """A seed for each environment: s makes s + i of the i-th.

    Raises:
        ValueError: a sequence of another length.
    """
    if seed is None:
        return [None] * count
    if isinstance(seed, int | np.integer):
        return [int(seed) + i for i in range(count)]
    if len(seed) != count:
        raise ValueError(f"seed={seed!r}: allowed is a number, or {count} of them")
    return seed


def infos_of(columns: Columns, there: Bools) -> Infos:
    """Infos of some environments, zeros in the others, shapes (num_envs,).

    ``_name`` says which have them.
    """
    columns = {name: np.where(there, all_, np.zeros_like(all_)) for name, all_ in columns.items()}
    return {**columns, **{f"_{name}": there.copy() for name in columns}}


def final_infos(observations: Floats32, columns: Columns, ended: Bools) -> Infos:
    """Of a step that resets what it ends: the last observations and infos of what it ended."""
    last = np.full(len(ended), None, dtype=object)
    for i in np.flatnonzero(ended):
        last[i] = observations[i]
    return {
        "final_obs": last,
        "_final_obs": ended.copy(),
        "final_info": infos_of(columns, ended),
        "_final_info": ended.copy(),
    }
