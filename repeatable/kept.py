"""What a Flower strategy keeps between rounds, as arrays by name, for checkpoints."""

from __future__ import annotations

import copy
import json
from contextlib import suppress
from typing import Any

import numpy as np
import numpy.typing as npt
from flwr.app import Array, ArrayRecord
from flwr.serverapp.strategy import FedAvg, Strategy

from storage.generators import generator_state, restore_generator

Items = dict[str, npt.NDArray[Any]]

_SETTINGS = frozenset(vars(FedAvg()))
"""FedAvg's own attributes: who is asked, and what metrics are called."""

KINDS = (
    "arrays, lists of arrays, dicts of arrays by texts or whole numbers, ArrayRecords, numbers,"
    " NumPy's generators, None, texts, lists and dicts as JSON has them, and strategies"
)


class Kept:
    """The attributes of a strategy that have changed since this was made, of a fresh one."""

    def __init__(self, strategy: Strategy) -> None:
        self._strategy = strategy
        self._within: dict[str, Kept] = {}
        self._fresh: dict[str, Any] = {}
        for name, value in vars(strategy).items():
            if isinstance(value, Strategy):
                self._within[name] = Kept(value)
            elif name not in _SETTINGS:
                with suppress(Exception):  # what cannot be copied stays as it is
                    self._fresh[name] = copy.deepcopy(value)

    def state(self) -> Items:
        """What is there now, as copies; empty where nothing has changed.

        Raises:
            ValueError: something has changed that cannot be kept; the message names it.
        """
        found: Items = {}
        for name, value in vars(self._strategy).items():
            if name in _SETTINGS:
                continue
            if name in self._within:
                inner = self._within[name].state()
                found.update({f"{name}.{key}": array for key, array in inner.items()})
                continue
            packed, before = _pack(value), _pack(self._fresh.get(name))
            if packed is None:
                if name in self._fresh and _differs(value, self._fresh[name]):
                    raise ValueError(
                        f"{type(self._strategy).__name__}.{name} has changed and is nothing that a"
                        f" checkpoint keeps: allowed are {KINDS}"
                    )
            elif before is None or name not in self._fresh or not _equal(packed, before):
                kind, items = packed
                found.update({f"{name}/{kind}/{key}": array for key, array in items.items()})
        return found

    def restore(self, state: Items) -> None:
        """Puts back what ``state`` gave, exactly; ``{}`` is a fresh strategy.

        Raises:
            ValueError: the state is another strategy's.
        """
        inner = {name: f"{name}." for name in self._within}
        own = {key: it for key, it in state.items() if not key.startswith(tuple(inner.values()))}
        foreign = [key for key in own if not hasattr(self._strategy, key.split("/")[0])]
        if foreign:
            name = type(self._strategy).__name__
            raise ValueError(f"{name} keeps no {', '.join(sorted(foreign))}: wrong strategy state")
        for name, value in self._fresh.items():
            setattr(self._strategy, name, copy.deepcopy(value))
        for name in {key.split("/")[0] for key in own}:
            setattr(self._strategy, name, _unpack(name, own))
        for name, start in inner.items():
            of = {key.removeprefix(start): it for key, it in state.items() if key.startswith(start)}
            self._within[name].restore(of)


def _pack(value: Any) -> tuple[str, Items] | None:
    """A value's kind and its arrays by name; None where it is nothing that is kept."""
    if value is None:
        return "none", {"0": np.zeros(0)}
    if isinstance(value, ArrayRecord):
        return "record", {key: array.numpy() for key, array in value.items()}
    if isinstance(value, np.ndarray):
        return "array", {"0": value.copy()}
    if isinstance(value, np.number | np.bool_):
        return "scalar", {"0": np.array([value])}
    if isinstance(value, np.random.Generator):
        return "generator", {"0": generator_state(value)}
    if isinstance(value, bool | int | float):
        number = np.array([value])
        return None if number.dtype == object else ("number", {"0": number})
    if isinstance(value, list) and all(isinstance(it, np.ndarray) for it in value):
        items = {str(i): it.copy() for i, it in enumerate(value)}
        return "list", {"length": np.array([len(value)]), **items}
    if isinstance(value, dict) and all(isinstance(it, np.ndarray) for it in value.values()):
        for kind, of in (("dict", str), ("intdict", int)):
            if all(type(key) is of for key in value):
                items = {f"={key}": it.copy() for key, it in value.items()}
                return kind, {"": np.array([len(value)]), **items}
    if isinstance(value, str | list | dict) and (text := _plain(value)):
        return "json", {"0": np.frombuffer(text.encode(), np.uint8)}
    return None


def _plain(value: Any) -> str | None:
    """A value as JSON, None where that would not give it back as it is."""
    try:
        text = json.dumps(value, allow_nan=False)
    except (TypeError, ValueError):
        return None
    return text if json.loads(text) == value else None


def _equal(one: tuple[str, Items], other: tuple[str, Items]) -> bool:
    """Whether two values are the same, to the bit."""
    (kind, items), (other_kind, others) = one, other
    if kind != other_kind or list(items) != list(others):
        return False
    pairs = [(it, others[key]) for key, it in items.items()]
    return all(it.dtype == its.dtype and it.tobytes() == its.tobytes() for it, its in pairs)


def _differs(value: Any, before: Any) -> bool:
    """Whether something that is not kept has changed, as far as it can be told."""
    try:
        return bool(value != before) and vars(value) != vars(before)
    except TypeError:  # no attributes: plain values, whose comparison stands
        return bool(value != before)
    except ValueError:  # arrays within
        return True


def _unpack(attribute: str, state: Items) -> Any:
    """The inverse of ``_pack``, for an attribute of which the state has something."""
    items, kind = {}, ""
    for key, array in state.items():
        name, kind_of_key, item = key.split("/", 2)
        if name == attribute:
            items[item], kind = array.copy(), kind_of_key
    if kind == "record":
        return ArrayRecord({item: Array(array) for item, array in items.items()})
    if kind == "list":
        return [items[str(i)] for i in range(int(items["length"][0]))]
    if kind in ("dict", "intdict"):
        to = int if kind == "intdict" else str
        return {to(key.removeprefix("=")): it for key, it in items.items() if key}
    if kind == "generator":
        generator = np.random.default_rng()
        restore_generator(generator, items["0"])
        return generator
    if kind == "none":
        return None
    if kind == "json":
        return json.loads(items["0"].tobytes())
    if kind == "number":
        return items["0"][0].item()
    return items["0"][0] if kind == "scalar" else items["0"]
