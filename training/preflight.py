"""Everything that can be known to be wrong before a run starts."""

from __future__ import annotations

import ipaddress
import os
import socket
from collections.abc import Sequence

from conf import Config, ConfigError, compose, flower_clients, from_yaml, learns_nothing
from env.validate import Problem
from training.aggregation.strategies import problems as strategy_problems

WORKERS_BEYOND_CORES = 4
MOST_WORKERS = 32
CORES_PER_CLIENT = 2


def max_concurrent_clients() -> int:
    """Clients that Flower's simulation engine runs at once on this machine.

    It uses a bare ``ThreadPoolExecutor``, which has min(32, cores + 4) workers. Robots in
    lockstep wait for each other, so one client more would never start.
    """
    return min(MOST_WORKERS, _cores() + WORKERS_BEYOND_CORES)


def default_concurrency() -> int:
    """Clients that Flower's simulation engine runs at once if it is told nothing else.

    It gives each client two cores. A run of ours that starts its own SuperLink asks for one core a
    client and as many cores as clients instead.
    """
    return max(1, _cores() // CORES_PER_CLIENT)


def _cores() -> int:
    return getattr(os, "process_cpu_count", os.cpu_count)() or 1


def check(config: Config) -> Config:
    """Checks what the schema alone cannot: strategies, and what the runtime can do here.

    Returns:
        The same configuration.

    Raises:
        ConfigError: names each key, its value and what is allowed.
    """
    found = strategy_problems(config.strategy, config.env.robots)
    if config.runtime.name == "simulation":
        found += _simulation_problems(config)
    if found:
        raise ConfigError.of(found)
    return config


def checked(overrides: Sequence[str]) -> Config:
    """Composes and checks a configuration.

    Raises:
        ConfigError: a wrong key, value or combination.
    """
    return check(compose(overrides))


def checked_training(overrides: Sequence[str]) -> Config:
    """Composes and checks a configuration in which something learns.

    Raises:
        ConfigError: a wrong key, value or combination, or nothing learns.
    """
    config = checked(overrides)
    if learns_nothing(config):
        say = "learned here: with it nothing learns, and risfleet evaluate plays it"
        raise ConfigError.of([("scheme.robots", config.scheme.robots, say)])
    return config


def checked_yaml(text: str) -> Config:
    """Reads and checks a configuration that a run has written.

    Raises:
        ConfigError: it does not fit this version.
    """
    return check(from_yaml(text))


def check_address(config: Config) -> None:
    """Checks that the link can listen where it is told to.

    Raises:
        ConfigError: the host is not this machine's, the link would leave it unencrypted, or the
            port is in use.
    """
    where = config.federation.link
    if config.runtime.name == "local":
        return
    try:
        family, *_, address = socket.getaddrinfo(where.host, where.port, type=socket.SOCK_STREAM)[0]
        socket.create_server((address[0], 0), family=family).close()
    except (OSError, UnicodeError) as error:
        allowed = f"an address of this machine, as robots reach it ({error})"
        raise ConfigError.of([("federation.link.host", where.host, allowed)]) from error
    if where.tls is False and not is_loopback(where.host):
        allowed = "true or null: beyond loopback the link is encrypted"
        raise ConfigError.of([("federation.link.tls", "false", allowed)])
    try:
        socket.create_server((address[0], where.port), family=family).close()
    except OSError as error:
        allowed = f"a port that is free on {where.host}, or 0 for any ({error.strerror})"
        raise ConfigError.of([("federation.link.port", where.port, allowed)]) from error


def is_loopback(host: str) -> bool:
    """Whether a name or address stays on this machine."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
        return all(ipaddress.ip_address(row[4][0]).is_loopback for row in found)
    except (OSError, ValueError, UnicodeError):
        return False


def uses_tls(config: Config) -> bool:
    """Whether the link is encrypted: as it is told, else wherever it leaves this machine."""
    where = config.federation.link
    if where.tls is None:
        return config.runtime.secure or not is_loopback(where.host)
    return where.tls


def _simulation_problems(config: Config) -> list[Problem]:
    most = max_concurrent_clients()
    if flower_clients(config) <= most:
        return []
    allowed = (
        f"at most {most} with runtime=simulation on this machine: Flower's engine runs no more"
        " clients at once, and robots in lockstep need all of theirs"
    )
    return [("federation.clients", config.federation.clients, allowed)]
