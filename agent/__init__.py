"""DQN agents that learn side by side.

| module | holds |
|---|---|
| `config` | the configuration's schema and checks |
| `exploration` | the epsilon schedule and random choices |
| `networks.mlp` | the flat layout of a network, first weights, the forward used to act |
| `networks.limits` | which weights are absurd |
| `replay` | transitions as packed rows in a ring |
| `learning.losses` | TD targets and the Huber loss |
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
    from agent.config import AgentConfig, DiscountConfig, EpsilonConfig, TargetConfig
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
    "TargetConfig",
    "epsilon_at",
    "q_values",
    "single_threaded",
]

_HOMES = {
    "agent.agents.branching": ["BranchingDQN"],
    "agent.agents.dqn": ["DQN"],
    "agent.config": ["AgentConfig", "DiscountConfig", "EpsilonConfig", "TargetConfig"],
    "agent.exploration": ["NO_ACTION", "epsilon_at"],
    "agent.learning.heads": ["Heads"],
    "agent.learning.learner": ["Learner"],
    "agent.networks.mlp": ["NetworkShape", "q_values"],
    "agent.threads": ["single_threaded"],
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(module), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
