"""Bytes that a run sends: federated learning, the lockstep link, and sending every transition.

The paper argues that federated learning spares communication, for robots send weights instead of
data. How much is sent either way follows from the configuration alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from conf import Config, flower_clients, robot_network
from lockstep.wire_format import actions_size, step_size
from training.aggregation.gossip import mean_degree
from training.exchange.packing import NUMBER, payload_bytes
from training.exchange.reception import asked_robots
from training.partition import partition_robots, step_layout


def per_tick(config: Config) -> dict[str, float]:
    """Bytes that all K robots together send and receive in a tick, by who learns and how.

    Returns:
        By name, all but the last in bytes:

        * ``weights``: online and target networks of every robot, up once and down once a window of
          N_F ticks, a tick's share. Payload only, packed where ``federation.compression`` says so;
          with ``federation.hear`` or ``.fraction`` the uploads of so many, and with
          ``federation.own`` what robots share. With ``strategy=gossip`` each robot sends to each of
          its neighbours, on random graphs in the mean, and nothing to the access point.
        * ``weights_per_window``: the same, a window's.
        * ``lockstep``: the frames of the link between world and robots, headers included: a step
          and its actions for each client, and a tick's share of the step that ends a window. On
          real robots the world itself takes their place.
        * ``lockstep_per_window``: the same, a window's.
        * ``transitions``: observation, action, reward, next observation and terminal flag of every
          robot, sent to a central learner, four bytes a number. A robot that has arrived sends
          nothing more, so this is the most.
        * ``transitions_per_window``: the same, a window's.
        * ``weights_over_transitions``: the ratio.
        * ``break_even_every``: the N_F in ticks above which federated learning sends less.
    """
    every, robots = config.federation.every, config.env.robots
    weights = _weights(config)
    numbers = 2 * robot_network(config).inputs + 3  # two observations, action, reward, terminal
    transitions = config.train.worlds * robots * NUMBER * numbers
    lockstep = _lockstep(config)
    return {
        "weights": weights / every,
        "weights_per_window": float(weights),
        "lockstep": lockstep / every,
        "lockstep_per_window": float(lockstep),
        "transitions": float(transitions),
        "transitions_per_window": float(every * transitions),
        "weights_over_transitions": weights / (every * transitions),
        "break_even_every": weights / transitions,
    }


def waiting(clients: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """How long an exchange keeps the server waiting for each client, and each for the others.

    Args:
        clients: each client's ``robots``, ``exchanges``, ``awaited_s`` and ``ahead_s``, as in
            ``summary.json``.

    Returns:
        For each client ``robots``; ``awaited_us``, from when the server has nothing left to do
        until this client's answer is there; ``ahead_us``, from then until the last client's is.
        Both are means over exchanges: one a tick, and one a window for the weights.
    """
    return [
        {
            "robots": client["robots"],
            "awaited_us": 1e6 * client["awaited_s"] / max(client["exchanges"], 1),
            "ahead_us": 1e6 * client["ahead_s"] / max(client["exchanges"], 1),
        }
        for client in clients
    ]


def _weights(config: Config) -> float:
    """Bytes of a window's weights: up and down, only up without a mean, or to neighbours."""
    up, down = payload_bytes(config)
    robots, name = config.env.robots, config.strategy.name
    if name == "gossip":
        return robots * mean_degree(config.strategy, robots) * up
    return asked_robots(config) * up + (0 if name == "none" else robots * down)


def _lockstep(config: Config) -> int:
    """Bytes of a window's steps and actions on the link."""
    blocks = partition_robots(config.env.robots, flower_clients(config))
    layout = step_layout(config)
    steps = sum(step_size(len(block), layout) for block in blocks)
    answers = sum(actions_size(len(block), layout) for block in blocks)
    every = config.federation.every
    return (every + 1) * steps + every * answers
