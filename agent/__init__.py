"""DQN agents that learn side by side.

| module | holds |
|---|---|
| `config` | the configuration's schema and checks |
| `exploration` | the epsilon schedule and random choices |
| `networks.mlp` | the flat layout of a network, first weights, the forward used to act |
| `networks.dueling` | dueling outputs made action values, and the way back |
| `networks.limits` | which weights are absurd |
| `replay.uniform` | transitions as packed rows in a ring |
| `replay.prioritised` | the same, drawn by how much they surprise |
| `replay.n_step` | transitions of several slots stored as one |
| `learning.losses` | TD targets and the Huber loss |
| `learning.interface` | what agents ask of a learner |
| `learning.buffers` | memory of stacked agents, and the scratch of a gradient step |
| `learning.gradients` | forward and backward of stacked agents, by hand |
| `learning.heads` | one network, a head for each part of a decision |
| `learning.learner` | weights, gradients and Adam of stacked agents |
| `agents.stack` | n agents' replays, streams and state |
| `agents.dqn` | `DQN`: the above as n agents that act, learn, save and go on |
| `agents.branching` | `BranchingDQN`: the same with a head for each part of a decision |
| `reference` | a plain DQN in PyTorch, to read first |
| `threads` | one thread of arithmetic per process |

Nothing here knows of the environment or of Flower, and no global random state is touched. The
names below are imported when they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from agent.agents.branching import BranchingDQN
    from agent.agents.dqn import DQN
    from agent.config import (
        AgentConfig,
        DiscountConfig,
        EpsilonConfig,
        PriorityConfig,
        TargetConfig,
    )
    from agent.exploration import NO_ACTION, epsilon_at
    from agent.learning.heads import Heads
    from agent.learning.learner import Learner
    from agent.networks.mlp import NetworkShape, q_values
    from agent.threads import single_threaded

__all__ = [
    "DQN",
    "NO_ACTION",
    "AgentConfig",
    "BranchingDQN",
    "DiscountConfig",
    "EpsilonConfig",
    "Heads",
    "Learner",
    "NetworkShape",
    "PriorityConfig",
    "TargetConfig",
    "epsilon_at",
    "q_values",
    "single_threaded",
]

_HOMES = {
    "AgentConfig": "agent.config",
    "BranchingDQN": "agent.agents.branching",
    "DQN": "agent.agents.dqn",
    "DiscountConfig": "agent.config",
    "EpsilonConfig": "agent.config",
    "Heads": "agent.learning.heads",
    "Learner": "agent.learning.learner",
    "NO_ACTION": "agent.exploration",
    "NetworkShape": "agent.networks.mlp",
    "PriorityConfig": "agent.config",
    "TargetConfig": "agent.config",
    "epsilon_at": "agent.exploration",
    "q_values": "agent.networks.mlp",
    "single_threaded": "agent.threads",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
