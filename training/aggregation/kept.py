"""What a Flower strategy keeps between windows, as arrays by name, for checkpoints."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import numpy.typing as npt
from flwr.app import Array, ArrayRecord
from flwr.serverapp.strategy import FedAvg, Strategy

from storage.generators import generator_state, restore_generator

State = dict[str, npt.NDArray[Any]]
Numbers = bool | int | float | np.number

_SETTINGS = frozenset(vars(FedAvg()))
"""FedAvg's own attributes: who is asked, and what metrics are called."""


class Kept:
    """The attributes of a strategy that change from window to window.

    Records, arrays, lists and dicts of arrays, and generators of NumPy's; of a class that is not
    Flower's numbers, too (Flower's hold nothing but settings in numbers).

    Args:
        strategy: a fresh one.
    """

    def __init__(self, strategy: Strategy) -> None:
        self._strategy = strategy
        self._counts = not type(strategy).__module__.startswith("flwr.")
        self._fresh = {
            name: copy.deepcopy(value)
            for name, value in vars(strategy).items()
            if value is None or self._pack(name, value)
        }

    def state(self) -> State:
        """What is there now, as copies; empty where nothing is kept."""
        found: State = {}
        for name, value in vars(self._strategy).items():
            found.update(self._pack(name, value))
        return found

    def restore(self, state: State) -> None:
        """Puts back what ``state`` gave, exactly; ``{}`` is a fresh strategy.

        Raises:
            ValueError: the state is another strategy's.
        """
        foreign = [key for key in state if not hasattr(self._strategy, key.split("/")[0])]
        if foreign:
            name = type(self._strategy).__name__
            raise ValueError(f"{name} keeps no {', '.join(sorted(foreign))}: wrong strategy state")
        for name, value in self._fresh.items():
            setattr(self._strategy, name, copy.deepcopy(value))
        for name in {key.split("/")[0] for key in state}:
            setattr(self._strategy, name, _unpack(name, state))

    def _pack(self, attribute: str, value: Any) -> State:
        """Flattens what is kept to ``attribute/kind/key``; anything else to nothing."""
        if attribute in _SETTINGS:
            return {}
        if isinstance(value, ArrayRecord):
            return {f"{attribute}/record/{key}": array.numpy() for key, array in value.items()}
        if isinstance(value, np.ndarray):
            return {f"{attribute}/array/0": value.copy()}
        if isinstance(value, np.random.Generator):
            return {f"{attribute}/generator/0": generator_state(value)}
        if isinstance(value, Numbers) and self._counts:
            return {f"{attribute}/number/0": np.array(value)}
        if not isinstance(value, dict | list):
            return {}
        pairs = value.items() if isinstance(value, dict) else enumerate(value)
        return {
            f"{attribute}/{type(value).__name__}/{key}": array.copy()
            for key, array in pairs
            if isinstance(array, np.ndarray)
        }


def _unpack(attribute: str, state: State) -> Any:
    """The inverse of ``Kept._pack``, for an attribute of which the state has something."""
    found, kind = {}, ""
    for key, array in state.items():
        name, kind_of_key, item = key.split("/", 2)
        if name == attribute:
            found[item], kind = array.copy(), kind_of_key
    if kind == "record":
        return ArrayRecord({item: Array(array) for item, array in found.items()})
    if kind == "list":
        return [found[str(i)] for i in range(len(found))]
    if kind == "number":
        return found["0"].item()
    if kind == "generator":
        generator = np.random.default_rng()
        restore_generator(generator, found["0"])
        return generator
    return found["0"] if kind == "array" else found
