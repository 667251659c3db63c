"""A channel model and a reward of the user's own, found by name (``docs/extending.md``).

A configuration holds a name, never a place to import from: a server's configuration cannot make a
client run anything but what is installed there under that name, or what a script registered.
"""

from __future__ import annotations

import hashlib
import inspect
import re
from collections.abc import Callable, Sequence
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from env.arrays import Bools, Complexes, Floats

if TYPE_CHECKING:
    from env.config import EnvConfig, RewardConfig
    from env.geometry.floor import Floor
    from env.validate import Problem

Tables = tuple[Complexes, Complexes]
"""hbar at each cell, shape (cells,), and c_n of each sub-surface at phase 0, shape (cells, N)."""

ChannelModel = Callable[["EnvConfig", "Floor"], Tables]
"""Makes the tables of a radio map; line of sight and phase settings are not its business."""

Reward = Callable[[Floats, Floats, Floats, Bools, "RewardConfig"], Floats]
"""A robot's reward, with the arguments of ``env.mdp.reward.local_reward``."""

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]{0,63}")


class PluginError(ValueError):
    """A model that is not there, does not load, or gives what it must not.

    ``allowed`` says what is, in the place of the name at the key.
    """

    def __init__(self, key: str, name: str, allowed: str) -> None:
        super().__init__(f"{key}={name}: allowed is {allowed}")
        self.problem: Problem = (key, name, allowed)


class Models:
    """The models that one key chooses from.

    Args:
        key: the key.
        ours: the names of models that are no plug-ins.
        group: the group of entry points in which packages list theirs.
    """

    def __init__(self, key: str, ours: Sequence[str], group: str) -> None:
        self.key, self.ours, self.group = key, ours, group
        self._registered: dict[str, Callable[..., Any]] = {}

    def register(self, name: str, function: Callable[..., Any]) -> None:
        """Makes a function known in this process; the same name again replaces it."""
        if not isinstance(name, str) or not _NAME.fullmatch(name) or name in self.ours:
            other = " and ".join(self.ours)
            say = f"a name other than {other}, of at most 64 letters, digits, '_', '-', '.'"
            raise PluginError(self.key, name, say)
        if not callable(function):
            raise PluginError(self.key, name, f"a function, not {type(function).__name__}")
        self._registered[name] = function

    def is_registered(self, name: str) -> bool:
        """Whether a script has made it known in this process."""
        return name in self._registered

    def find(self, name: str) -> Callable[..., Any] | None:
        """The function of a name, None for ours.

        Raises:
            PluginError: there is none, or more than one, or it does not load.
        """
        if name in self.ours:
            return None
        if name in self._registered:
            return self._registered[name]
        entry = self.entry(name)
        if entry is None:
            names = ", ".join(self._names())
            allowed = f"one of {names}" if names else "the name of one that is installed"
            raise PluginError(self.key, name, allowed)
        try:
            function = entry.load()
        except Exception as error:
            say = f"a model that loads: {entry.value} gives {type(error).__name__}: {error}"
            raise PluginError(self.key, name, say) from error
        if not callable(function):
            raise PluginError(self.key, name, f"a function, which {entry.value} is not")
        return function  # type: ignore[no-any-return]

    def entry(self, name: str) -> metadata.EntryPoint | None:
        """The entry point of that name, unless it is registered here or no package has it."""
        if name in self._registered:
            return None
        found = [*metadata.entry_points(group=self.group, name=name)]
        if len(found) > 1:
            places = " and ".join(sorted(entry.value for entry in found))
            raise PluginError(self.key, name, f"a name that one package brings, not {places}")
        return found[0] if found else None

    def _names(self) -> list[str]:
        installed = {entry.name for entry in metadata.entry_points(group=self.group)}
        return [*self.ours, *sorted({*installed, *self._registered} - {*self.ours})]


_CHANNELS = Models("env.channel.model", ("indoor_hotspot", "file"), "risfleet.channel_models")
_REWARDS = Models("env.reward.model", ("paper",), "risfleet.rewards")


def register_channel_model(name: str, function: ChannelModel) -> None:
    """Makes a channel model known in this process, as ``env.channel.model=NAME``.

    Args:
        name: letters, digits, ``_``, ``-`` and ``.``; again the same name replaces the function.
        function: of the configuration and the floor; gives hbar, complex, shape (cells,), nowhere
            zero, and c_n, complex, shape (cells, N).

    Raises:
        ValueError: that is no such name, or no function.
    """
    _CHANNELS.register(name, function)


def register_reward(name: str, function: Reward) -> None:
    """Makes a reward of the robots known in this process, as ``env.reward.model=NAME``.

    Args:
        name: as of ``register_channel_model``.
        function: with the arguments of ``env.mdp.reward.local_reward``, element by element; gives
            rewards of their shape, float64. Its rate is the credit with ``reward.credit``.

    Raises:
        ValueError: that is no such name, or no function.
    """
    _REWARDS.register(name, function)


def problems(config: EnvConfig) -> list[Problem]:
    """Which of the two models cannot be had: keys, their values, and what is allowed there."""
    found = []
    for models, name in _chosen(config):
        try:
            models.find(name)
        except PluginError as error:
            found.append(error.problem)
    return found


def identities(config: EnvConfig) -> list[str]:
    """The plug-ins that a configuration uses, each with a digest of its source file.

    Two sides with the same list run the same functions, as far as their modules tell: of what
    these import, only the version of their own package is in it.
    """
    found = []
    for models, name in _chosen(config):
        function = models.find(name)
        if function is not None:
            entry = models.entry(name)
            dist = entry.dist if entry else None
            package = f"{dist.name} {dist.version}, " if dist else ""
            found.append(f"{models.key}={name} ({package}{_source(function)})")
    return found


def own_channel(config: EnvConfig, floor: Floor) -> Tables | None:
    """The tables of the user's channel model, checked; None where it is ours.

    With ``ris.side=0`` there is no RIS, and c_n is zero whatever the model says.

    Raises:
        PluginError: the model is not there, or its tables are not what they must be.
    """
    name = config.channel.model
    model = _CHANNELS.find(name)
    if model is None:
        return None
    tables = model(config, floor)
    if not isinstance(tables, tuple) or len(tables) != 2:
        raise PluginError(_CHANNELS.key, name, "a model that gives two tables, direct, reflected")
    direct = _table(name, "direct", tables[0], (floor.cells,))
    reflected = _table(name, "reflected", tables[1], (floor.cells, config.ris.subsurfaces))
    if not np.abs(direct).all():
        raise PluginError(_CHANNELS.key, name, "a model whose direct is nowhere zero")
    return direct, reflected if config.ris.side else np.zeros_like(reflected)


def own_reward(config: EnvConfig) -> Reward | None:
    """The user's reward, each result of which is checked; None where it is the paper's.

    Raises:
        PluginError: the model is not there.
    """
    name = config.reward.model
    function = _REWARDS.find(name)
    return None if function is None else partial(_checked_reward, name, function)


def _chosen(config: EnvConfig) -> tuple[tuple[Models, str], ...]:
    return (_CHANNELS, config.channel.model), (_REWARDS, config.reward.model)


def _source(function: Callable[..., Any]) -> str:
    """A short digest of the file that a function is from."""
    try:
        path = Path(inspect.getsourcefile(function) or "")
        return hashlib.sha256(path.read_bytes()).hexdigest()[:12]
    except (TypeError, OSError):
        return "no source file"


def _table(name: str, which: str, table: Any, shape: tuple[int, ...]) -> Complexes:
    """A copy of one table of a channel model, if it is what it must be."""
    _check(_CHANNELS.key, name, which, table, shape, np.complexfloating)
    return np.array(table, dtype=np.complex128, order="C")


def _checked_reward(
    name: str,
    function: Reward,
    rate: Floats,
    before_m: Floats,
    after_m: Floats,
    arrived: Bools,
    weights: RewardConfig,
) -> Floats:
    """Calls a reward on copies, so that it changes nothing and sees one layout everywhere."""
    found = function(rate.copy(), before_m.copy(), after_m.copy(), arrived.copy(), weights)
    _check(_REWARDS.key, name, "reward", found, np.shape(rate), np.float64)
    return found


def _check(key: str, name: str, which: str, array: Any, shape: tuple[int, ...], kind: type) -> None:
    wanted = "complex" if kind is np.complexfloating else "float64"
    if not isinstance(array, np.ndarray):
        say = f"an array, not {type(array).__name__}"
    elif array.shape != shape:
        say = f"of shape {shape}, not {array.shape}"
    elif not np.issubdtype(array.dtype, kind):
        say = f"{wanted}, not {array.dtype}"
    elif not np.isfinite(array).all():
        say = "finite everywhere"
    else:
        return
    raise PluginError(key, name, f"a model whose {which} is {say}")
