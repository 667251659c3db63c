"""What several tests of the agents share: random experience and fleets of agents."""

import numpy as np

from agent import DQN, AgentConfig, NetworkShape


def generators(seeds):
    return [np.random.Generator(np.random.PCG64(seed)) for seed in seeds]


class Experience:
    """Random transitions of n agents over some ticks, with idle agents and late starters."""

    def __init__(self, shape, agents, ticks, seed=0, idle=0.2, late=15):
        """Draws everything at once; agent i is idle for the first i * late ticks."""
        rng = np.random.default_rng(seed)
        self.ticks = ticks
        self.observations = rng.normal(size=(ticks, agents, shape.inputs)).astype(np.float32)
        self.next = rng.normal(size=(ticks, agents, shape.inputs)).astype(np.float32)
        self.rewards = rng.normal(scale=20, size=(ticks, agents))
        self.terminal = rng.random((ticks, agents)) < 0.1
        self.active = rng.random((ticks, agents)) >= idle
        for agent in range(agents):
            self.active[: late * agent, agent] = False


def fleet(shape, config, seeds, discount=0.8, mu=0.0, worlds=1):
    """Agents with the given streams, each with first weights of its own seed."""
    agents = DQN(shape, config, discount, generators(seeds), proximal_mu=mu, worlds=worlds)
    agents.load(
        np.stack(
            [
                np.stack([shape.initial_weights(np.random.default_rng(s + i)) for i in (0, 50)])
                for s in seeds
            ]
        )
    )
    return agents


def live(agents, experience, members, start=0, stop=None):
    """Plays ticks for the agents, or for the worlds of agents, at `members` of the experience.

    Returns:
        Actions, shape (ticks, members), and losses, shape (ticks, agents).
    """
    actions, losses = [], []
    for t in range(start, experience.ticks if stop is None else stop):
        active = experience.active[t, members]
        chosen = agents.act(experience.observations[t, members], 0.3, active)
        actions.append(chosen)
        losses.append(
            agents.learn(
                experience.observations[t, members],
                chosen,
                experience.rewards[t, members],
                experience.next[t, members],
                experience.terminal[t, members],
                active,
            )
        )
    return np.array(actions), np.array(losses)


def small_config(**changes):
    values = {"hidden": [13, 27], "batch_size": 16, "learn_from": 20, "replay_size": 60}
    return AgentConfig(**{**values, "learning_rate": 1e-3, **changes})


def shape_of(config, inputs=5, actions=7):
    return NetworkShape(inputs, tuple(config.hidden), actions)


def same_bits(one, other):
    return np.asarray(one).tobytes() == np.asarray(other).tobytes()
