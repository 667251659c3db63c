"""Configurations that are checked before a run starts, this machine's limits included."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from conf import Config, ConfigError, compose, flower_clients, from_yaml, has_rooms, learns_nothing
from conf.rooms import rooms_of
from env.config import EnvConfig
from env.plugins import PluginError
from env.radio import channel_file
from training.engine_limits import max_concurrent_clients
from training.recording import tracking


def check(config: Config) -> Config:
    """Checks what the configuration alone cannot tell: what the runtime can do here.

    Returns:
        The same configuration.

    Raises:
        ConfigError: names each key, its value and what is allowed.
    """
    clients, most = flower_clients(config), max_concurrent_clients()
    if config.runtime.name == "simulation" and clients > most:
        allowed = (
            f"at most {most} with runtime=simulation on this machine: Flower's engine runs no more"
            " clients at once, and robots in lockstep need all of theirs"
        )
        raise ConfigError.of([("federation.clients", config.federation.clients, allowed)])
    rooms = [config.env]
    if has_rooms(config):
        rooms = [room.config(config).env for room in rooms_of(config)]  # draws and checks each
    if config.env.channel.model == "file":
        _check_channels(rooms)
    return config


def checked(overrides: Sequence[str]) -> Config:
    """Composes and checks a configuration; errors as ``check``."""
    return check(compose(overrides))


def checked_training(overrides: Sequence[str]) -> Config:
    """Composes and checks a configuration in which something learns.

    Raises:
        ConfigError: a wrong key, value or combination, or nothing learns.
    """
    config = checked(overrides)
    check_trackers(config)
    check_strategies(config)
    if learns_nothing(config):
        say = "learned here: with it nothing learns, and risfleet evaluate plays it"
        raise ConfigError.of([("scheme.robots", config.scheme.robots, say)])
    return config


def check_trackers(config: Config) -> None:
    """Checks that the trackers that a run has chosen are installed where it is recorded.

    That of another machine's ServerApp cannot be told from here.
    """
    if config.runtime.connection is None and (found := tracking.problems(config.run)):
        raise ConfigError.of(found)


def check_strategies(config: Config) -> None:
    """Checks that strategies of the user's own are there, where this machine runs the server.

    Each is asked for one average, of networks of a few weights.

    Raises:
        ConfigError: one is not there, does not take its options, or gives no average.
    """
    counts = {"strategy": config.env.robots, "rooms.strategy": config.rooms.count}
    for key, strategy in (("strategy", config.strategy), ("rooms.strategy", config.rooms.strategy)):
        if strategy.name != "own" or config.runtime.connection is not None:
            continue
        from training.aggregation.own import try_out  # Flower: only where it is wanted

        try:
            try_out(strategy, counts[key], in_this_process=config.runtime.name == "local")
        except PluginError as error:
            raise ConfigError.of([error.problem]) from error


def checked_yaml(text: str) -> Config:
    """Reads and checks a configuration that a run has written.

    Raises:
        ConfigError: it does not fit this version.
    """
    return check(from_yaml(text))


def _check_channels(rooms: Sequence[EnvConfig]) -> None:
    """Checks that the file of channels fits each of the rooms, which may be alike."""
    seen: list[EnvConfig] = []
    for room in (dataclasses.replace(room, map_seed=0, plan="", robots=1) for room in rooms):
        if room not in seen:
            seen.append(room)
            if found := channel_file.problems(room):
                raise ConfigError.of(found)
