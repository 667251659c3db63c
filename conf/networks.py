"""The sizes of the networks that a configuration describes, for every side that builds one."""

from __future__ import annotations

from agent import Heads, NetworkShape
from conf.schema import Config
from env.config import phase_actions
from env.downlink.combinations import count_combinations
from env.mdp.actions import ActionSpace
from env.mdp.observation import ObservationEncoder


def robot_actions(config: Config) -> ActionSpace:
    """What a robot chooses: a direction and a power level, or where others pick powers no level."""
    own = config.scheme.power == "robots"
    return ActionSpace.from_config(config.env) if own else ActionSpace(1)


def ap_actions(config: Config) -> int:
    """The actions of the access point, or of the head in its place.

    They are its phase settings or its codebook's beams; with ``scheme.power=ap`` a setting c and
    one of C combinations of powers i make action c C + i.
    """
    phases = phase_actions(config.env.ris)
    if config.scheme.power != "ap":
        return phases
    return phases * count_combinations(config.env, config.env.robots)


def robot_network(config: Config) -> NetworkShape:
    """The DQN of each robot: s_L to 4 N_P actions, or 4 where others pick powers."""
    return NetworkShape(
        ObservationEncoder(config.env).local_size,
        tuple(config.agent.hidden),
        robot_actions(config).count,
    )


def ap_network(config: Config) -> NetworkShape:
    """The network that sees s_G: the access point's, or that of one agent for everything.

    The access point's goes to its own actions, a centralized DQN's to all joint actions, a
    branching one's to the actions of all heads.
    """
    outputs = ap_actions(config)
    if config.scheme.agents == "centralized":
        outputs = joint_actions(config)
    elif config.scheme.agents == "branching":
        outputs = central_heads(config).actions
    inputs = ObservationEncoder(config.env).global_size
    return NetworkShape(inputs, tuple(config.agent.hidden), outputs)


def joint_actions(config: Config) -> int:
    """The actions of all agents taken together, N_R^N (4 N_P)^K where robots pick powers."""
    return robot_actions(config).joint_count(ap_actions(config), config.env.robots)


def central_heads(config: Config) -> Heads:
    """The heads of a branching DQN: the RIS's, then one for each robot.

    With rewards of their own, heads have the discounts of the agents in whose place they stand.
    """
    discount, robots = config.agent.discount, config.env.robots
    shared = config.scheme.heads == "shared"
    return Heads(
        (ap_actions(config), *[robot_actions(config).count] * robots),
        (discount.robot if shared else discount.ap, *[discount.robot] * robots),
        shared,
    )


def robots_learn(config: Config) -> bool:
    """Whether robots have networks of their own."""
    return config.scheme.agents == "federated" and config.scheme.robots == "learned"


def learns_nothing(config: Config) -> bool:
    """Whether neither the robots nor the access point have a network."""
    return config.scheme.robots != "learned"


def weight_shapes(config: Config) -> dict[str, tuple[int, ...]]:
    """Shapes of a run's weights, online then target; without a network, P is 0.

    Returns:
        "robots": (K, 2, P), "ap": (2, P_AP).
    """
    robot = robot_network(config).parameters if robots_learn(config) else 0
    ap = ap_network(config).parameters if config.scheme.phase == "learned" else 0
    return {"robots": (config.env.robots, 2, robot), "ap": (2, ap)}
