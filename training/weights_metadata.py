"""What a file of weights says of itself, so that it can be played without any other file."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent import NetworkShape
from conf import Config, ConfigError, ap_network, from_yaml, robot_network, to_yaml, version
from conf.python_values import value_text
from conf.schema import LinkConfig, RunConfig, RuntimeConfig
from storage.checkpoint_files import digest

FORMAT = "risfleet-weights"
FORMAT_VERSION = "1"


def describe(
    config: Config, robots: NDArray[np.float32], ap: NDArray[np.float32]
) -> dict[str, str]:
    """The metadata of a run's weights.

    Args:
        config: the run's; where it ran is left out.
        robots: shape (K, 2, P).
        ap: shape (2, P_AP).

    Returns:
        Texts by name: what the file is, the sizes of the layers, digests of the weights, the keys
        that differ from their defaults as Hydra overrides, and the whole configuration as YAML.
    """
    config = _anywhere(config)
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "risfleet_version": version("risfleet"),
        "robots": str(config.env.robots),
        "robots_network": widths(robot_network(config)) if robots.shape[-1] else "none",
        "ap_network": widths(ap_network(config)) if ap.shape[-1] else "none",
        "plan": config.env.plan,
        "robots_sha256": digest(robots),
        "ap_sha256": digest(ap),
        "overrides": shlex.join(_changes(dataclasses.asdict(config), dataclasses.asdict(Config()))),
        "config": to_yaml(config),
    }


def config_in(metadata: Mapping[str, str]) -> Config | None:
    """The configuration in the metadata of weights; None if it is none of ours.

    Raises:
        ConfigError: it is a later version's, or does not fit this one's schema.
    """
    if metadata.get("format") != FORMAT or "config" not in metadata:
        return None
    found = metadata.get("format_version")
    if found != FORMAT_VERSION:
        raise ConfigError(f"the weights are of format {found}: allowed is {FORMAT_VERSION}.")
    return from_yaml(metadata["config"])


def widths(network: NetworkShape) -> str:
    """The sizes of a network's layers, inputs first: "5 - 64 - 64 - 24"."""
    return " - ".join(map(str, (network.inputs, *(width for _, width in network.layers))))


def _anywhere(config: Config) -> Config:
    """A configuration without what says where it ran."""
    federation = dataclasses.replace(config.federation, clients=None, link=LinkConfig())
    env = config.env
    if env.channel.file is not None:  # whose digest says which it is
        channel = dataclasses.replace(env.channel, file=Path(env.channel.file).name)
        env = dataclasses.replace(env, channel=channel)
    return dataclasses.replace(
        config, env=env, run=RunConfig(), runtime=RuntimeConfig(), federation=federation
    )


def _changes(own: Mapping[str, Any], default: Mapping[str, Any], above: str = "") -> Iterator[str]:
    for name, value in own.items():
        if isinstance(default[name], dict):
            yield from _changes(value, default[name], f"{above}{name}.")
        elif value != default[name]:
            yield f"{above}{name}={value_text(above + name, value)}"
