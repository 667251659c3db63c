"""Memory of stacked agents: parts that start on cache lines, and the scratch of a gradient step."""

from __future__ import annotations

import numpy as np
import torch

from agent.config import AgentConfig
from agent.networks.mlp import NetworkShape

_ALIGNMENT = 16  # floats: one cache line


def aligned_zeros(agents: int, *shape: int) -> torch.Tensor:
    """Zeros of shape (agents, *shape) in which each agent's part starts on a cache line.

    An agent's numbers then lie alike whether it is alone or one of many; vectorised loops may
    depend on alignment. An agent's part is contiguous.
    """
    size = int(np.prod(shape))
    padded = -(-size // _ALIGNMENT) * _ALIGNMENT
    return torch.zeros(agents, padded)[:, :size].view(agents, *shape)


class Workspace:
    """Buffers of one gradient step of up to n agents; what they hold matters within it alone.

    A learner takes its steps in the same few, one after the other: they stay in a core's cache.

    Attributes:
        layers: of the forward, see `_layers`.
        chooser: likewise, of double DQN's choice of actions; None without it.
        grads: of each layer's outputs, shapes (n, outputs, B).
    """

    def __init__(self, shape: NetworkShape, config: AgentConfig, passes: int, agents: int) -> None:
        """Reserves the buffers of n agents.

        `passes` is 2 for the forward of states and of next states, 1 for states alone.
        """
        size = config.batch_size
        double = config.double and passes == 2
        self.layers = _layers(shape, agents, passes, size)
        self.chooser = _layers(shape, agents, 1, size) if double else None
        self.grads = [aligned_zeros(agents, width, size) for _, width in shape.layers]


def _layers(shape: NetworkShape, agents: int, passes: int, batch_size: int) -> list[torch.Tensor]:
    """What each layer reads, a constant 1 last, and the action values.

    Returns:
        Shapes (n, passes, features + 1, B), and (n, passes, actions, B) at the end.
    """
    widths = (shape.inputs, *shape.hidden)
    read = [aligned_zeros(agents, passes, width + 1, batch_size) for width in widths]
    for activation in read:
        activation[:, :, -1] = 1
    return [*read, aligned_zeros(agents, passes, shape.actions, batch_size)]
