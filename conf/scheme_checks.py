"""What is allowed in the group ``scheme``: who decides, and with what else that goes."""

from __future__ import annotations

from collections.abc import Iterator

from conf.networks import ap_actions, joint_actions
from conf.schema import Config, SchemeConfig
from env.downlink.combinations import count_combinations
from env.oracles.per_slot import MAX_COMBINATIONS
from env.validate import Problem

MOST_JOINT_ACTIONS = 100_000
"""A network's outputs: a centralized DQN of K = 3 with the paper's actions has 55,296."""


def rules(config: Config) -> Iterator[Problem]:
    """What is wrong with a scheme, of a configuration otherwise right: what is found first."""
    scheme = config.scheme
    found = list(_unread_keys(scheme))
    if scheme.power != "robots":
        found = found or list(_power_problems(config))
    if scheme.agents != "federated":
        found = found or list(_central_problems(config))
    if scheme.robots != "learned":
        found = found or list(_idle_problems(config))
    yield from found


def _unread_keys(scheme: SchemeConfig) -> Iterator[Problem]:
    """Keys that are set where nothing reads them."""
    default, branching = SchemeConfig(), scheme.agents == "branching"
    if scheme.heads != default.heads and not branching:
        say = f"{default.heads} with scheme.agents={scheme.agents}: only branching reads it"
        yield "scheme.heads", scheme.heads, say
    whole = scheme.agents == "centralized" or (branching and scheme.heads == "shared")
    if scheme.global_share != default.global_share and not whole:
        say = (
            f"{default.global_share} here: only scheme.agents=centralized, and branching with"
            " scheme.heads=shared, read it"
        )
        yield "scheme.global_share", scheme.global_share, say


def _power_problems(config: Config) -> Iterator[Problem]:
    """Powers that robots do not pick: with what else that goes, and how many there may be."""
    scheme, power = config.scheme, config.env.power
    who = f"scheme.power={scheme.power}"
    if scheme.robots != "learned":
        say = f"robots with scheme.robots={scheme.robots}, which has a rule for powers of its own"
        yield "scheme.power", scheme.power, say
    elif scheme.power == "search":
        env = config.env
        count = max(count_combinations(env, served) for served in range(1, env.robots + 1))
        if count > MAX_COMBINATIONS:
            say = (
                f"fewer with {who}: these are {_about(count)} combinations of powers in"
                f" a slot, and at most {MAX_COMBINATIONS:,} are searched"
            )
            yield "env.power.levels", power.levels, say
    elif scheme.phase != "learned":
        say = f"learned with {who}: one DQN picks the phase and the powers together"
        yield "scheme.phase", scheme.phase, say
    elif config.env.access == "noma" and power.resolve != "project":
        say = f"project with {who}: it picks among powers that can be decoded"
        yield "env.power.resolve", power.resolve, say
    elif scheme.agents != "centralized" and (count := ap_actions(config)) > MOST_JOINT_ACTIONS:
        say = (
            f"fewer with {who}: phase settings times combinations of powers are {_about(count)},"
            f" and at most {MOST_JOINT_ACTIONS:,} are taken"
        )
        yield "env.power.levels", power.levels, say


def _about(count: int) -> str:
    """A count that may be astronomical."""
    return f"{count:,}" if count < 10**12 else f"{count:.1e}"


def _central_problems(config: Config) -> Iterator[Problem]:
    """One agent for everything: it has no federation, and leaves nothing for others to decide."""
    who = f"scheme.agents={config.scheme.agents}"
    if config.runtime.name != "local":
        say = f"local with {who}: one agent for everything has no federation"
        yield "runtime.name", config.runtime.name, say
    if config.strategy.name != "none":
        say = f"none with {who}: there is nothing to aggregate"
        yield "strategy.name", config.strategy.name, say
    for key in ("phase", "robots"):
        if getattr(config.scheme, key) != "learned":
            yield f"scheme.{key}", getattr(config.scheme, key), f"learned with {who}"
    if (order := config.env.state.order) != "index":
        yield "env.state.order", order, f"index with {who}: it acts for robots by their index"
    count = joint_actions(config)
    if config.scheme.agents == "centralized" and count > MOST_JOINT_ACTIONS:
        say = (
            f"fewer with {who}: the joint actions of all are {count:,}, and at most"
            f" {MOST_JOINT_ACTIONS:,} are taken (scheme.agents=branching has no such bound)"
        )
        yield "env.robots", config.env.robots, say


def _idle_problems(config: Config) -> Iterator[Problem]:
    """Robots that drive shortest ways: nothing is learned, by them or by the access point."""
    scheme = config.scheme
    who = f"scheme.robots={scheme.robots}"
    if config.runtime.name != "local":
        say = f"local with {who}: robots that learn nothing have no federation"
        yield "runtime.name", config.runtime.name, say
    if scheme.phase == "learned":
        yield "scheme.phase", scheme.phase, f"random, fixed or oracle with {who}"
    elif scheme.robots == "shortest_best" and scheme.phase != "oracle":
        say = f"oracle with {who}: phases and powers are searched together"
        yield "scheme.phase", scheme.phase, say
