"""A DQN that decides in parts: one network, a trunk for all and a head for each part.

The loss is the mean over heads of each head's Huber loss on its action's value (Tavakoli et al.,
AAAI 2018, with Huber's loss for the square and without their dueling stream), so the trunk
gets the mean of what the heads send back.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent.agents.stack import ReplayAgents
from agent.config import AgentConfig
from agent.exploration import NO_ACTION
from agent.learning.gradients import GradientStep
from agent.learning.heads import HeadRows, Heads
from agent.learning.learner import Learner
from agent.learning.losses import huber
from agent.networks.mlp import FloatArray, NetworkShape, forward


class BranchingDQN(ReplayAgents):
    """One agent with several heads, each of which explores by itself."""

    def __init__(
        self,
        shape: NetworkShape,
        heads: Heads,
        config: AgentConfig,
        generator: np.random.Generator,
        worlds: int = 1,
    ) -> None:
        """Makes an agent with weights of zero; `load` gives it its first ones.

        Args:
            shape: of the network, whose actions are all heads' together.
            heads: in the order of the actions.
            config: how it learns.
            generator: its own.
            worlds: E, in each of which it decides.
        """
        self.heads = heads
        self._layout = HeadRows(shape.inputs, len(heads.sizes))
        learner = BranchingLearner(shape, heads, config, self._layout)
        super().__init__(shape, config, learner, [generator], worlds)
        self._layers = shape.views(self.online)
        self._always = np.ones(worlds, dtype=bool)

    def choose(
        self, observations: FloatArray, epsilon: float, active: NDArray[np.bool_]
    ) -> NDArray[np.int32]:
        """Chooses each part epsilon-greedily.

        Args:
            observations: in each world, shape (E, inputs).
            epsilon: share of random actions, for each head by itself.
            active: which heads have something to decide, shape (E, H).

        Returns:
            Actions, -1 for the idle, shape (E, H).
        """
        draw = self._generators[0].random
        choices = self.heads.best(forward(self._layers, observations[None])[0]).tolist()
        for chosen, decides in zip(choices, active.tolist(), strict=True):
            for head, size in enumerate(self.heads.sizes):
                if not decides[head]:
                    chosen[head] = NO_ACTION
                elif draw() < epsilon:
                    chosen[head] = int(draw() * size)
        return np.array(choices, np.int32)

    def learn(
        self,
        observations: ArrayLike,
        actions: ArrayLike,
        rewards: ArrayLike,
        next_observations: ArrayLike,
        terminal: ArrayLike,
        active: NDArray[np.bool_],
    ) -> float:
        """Stores a transition of each world and, once enough are held, learns.

        Args:
            observations: shape (E, inputs).
            actions: of each head, shape (E, H); any for an idle one.
            rewards: of each, unscaled, shape (E, H).
            next_observations: shape (E, inputs).
            terminal: whether each head's part has ended for good, shape (E, H).
            active: which heads had something to decide, shape (E, H).

        Returns:
            The mean loss, nan where no update was made.
        """
        scaled = np.multiply(rewards, self._config.reward_scale)
        chosen = np.maximum(actions, 0)
        self._layout.pack(
            observations, chosen, scaled, next_observations, terminal, active, self._rows
        )
        return float(self._take_rows(self._always)[0])


class _HeadStep(GradientStep):
    """One gradient step of a network with several heads, on rows of their own layout."""

    def take(self, heads: Heads, rows: HeadRows) -> None:
        """Says what the outputs are, and where a transition's fields stand."""
        self._heads, self._rows, self._samples = heads, rows, np.arange(self._size)

    def run(self) -> FloatArray:
        """Computes the gradient; returns the mean loss, shape (1,)."""
        self._run_forward()
        fields, layout, samples = self._batch[0].T, self._rows, self._samples
        active, terminal = fields[layout.active], fields[layout.terminal]
        q, target_q = self._forward.q[0]
        by = self._next_online_q()
        values = self._heads.values(target_q, None if by is None else by[0])
        going_on = active * (1 - terminal)
        targets = self._heads.targets(fields[layout.rewards], terminal, going_on, values)
        places = fields[layout.actions].astype(np.intp) + self._heads.starts[:, None]
        losses, grad = huber(q[places, samples] - targets, self._config.huber_delta)
        share = active / np.float32(active.size)
        self._backward.grad.fill(0)
        self._backward.grad[0, places, samples] = grad * share
        self._backward.run()
        return np.array([(losses * share).sum()], np.float32)


class BranchingLearner(Learner):
    """The learner of one network with several heads, whose discounts are the heads' own."""

    _step_type = _HeadStep

    def __init__(
        self, shape: NetworkShape, heads: Heads, config: AgentConfig, layout: HeadRows
    ) -> None:
        """Reserves the network's rows, all zero."""
        self._heads, self._layout = heads, layout
        super().__init__(shape, config, discount=1.0, agents=1, width=layout.width)

    def _plan(self, start: int, stop: int) -> GradientStep:
        step = super()._plan(start, stop)
        assert isinstance(step, _HeadStep)
        step.take(self._heads, self._layout)
        return step
