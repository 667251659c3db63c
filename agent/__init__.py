"""DQN agents that learn side by side, and what they keep on disk.

| module | holds |
|---|---|
| `reference` | one plain DQN in PyTorch: read it first |
| `config` | the configuration's schema and checks |
| `dueling` | dueling outputs made action values, and the way back |
| `network` | the flat layout of a network, first weights, the forward used to act |
| `replay` | transitions as packed rows in a ring |
| `priority` | the same, drawn by how much they surprise |
| `returns` | transitions of several slots stored as one |
| `exploration` | the epsilon schedule and random choices |
| `losses` | TD targets and the Huber loss |
| `buffers` | memory of stacked agents, and the scratch of a gradient step |
| `backprop` | forward and backward of stacked agents, by hand |
| `interface` | what agents ask of a learner |
| `learner` | weights, gradients and Adam of stacked agents |
| `stack` | n agents' replays, streams and state |
| `dqn` | `DQN`: the above as n agents that act, learn, save and go on |
| `heads`, `branching` | one network, a head for each part of a decision: `BranchingDQN` |
| `streams` | a random stream's state as an array |
| `storage` | atomic checkpoints and digests |
| `threads` | one thread of arithmetic per process |

Nothing here knows of the environment or of Flower, and no global random state is touched.
"""

from agent.branching import BranchingDQN
from agent.config import (
    AgentConfig,
    DiscountConfig,
    EpsilonConfig,
    PriorityConfig,
    TargetConfig,
)
from agent.dqn import DQN
from agent.exploration import NO_ACTION, epsilon_at
from agent.heads import Heads
from agent.learner import Learner
from agent.network import NetworkShape, q_values
from agent.storage import (
    CheckpointError,
    Writer,
    checkpoints,
    digest,
    load_checkpoint,
    naming,
    save_checkpoint,
    write_whole,
)
from agent.streams import generator_state, restore_generator
from agent.threads import single_threaded

__all__ = [
    "DQN",
    "NO_ACTION",
    "AgentConfig",
    "BranchingDQN",
    "CheckpointError",
    "DiscountConfig",
    "EpsilonConfig",
    "Heads",
    "Learner",
    "NetworkShape",
    "PriorityConfig",
    "TargetConfig",
    "Writer",
    "checkpoints",
    "digest",
    "epsilon_at",
    "generator_state",
    "load_checkpoint",
    "naming",
    "q_values",
    "restore_generator",
    "save_checkpoint",
    "single_threaded",
    "write_whole",
]
