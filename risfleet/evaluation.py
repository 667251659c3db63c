"""What a policy is worth on held-out starts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from conf import Config, ConfigError, learns_nothing
from conf.python_values import Overrides, override_texts
from env.episode import EpisodeMeasures
from experiments.analysis.frozen import check_options, play, without_weights


@dataclass(frozen=True)
class Evaluation:
    """What a policy is worth: means over held-out episodes.

    Attributes:
        epsilon: probability of a random action that it was played with.
        success: share of the robots that arrived.
        path_ratio: slots driven over the shortest length, of robots that arrived.
        reward: total of the robots' rewards.
        ee: energy efficiency in bit/s/Hz/J, the objective (5a).
        ee_bits_per_joule: all bits over all energy, in bit/J.
        sum_rate: sum of the rates in bit/s/Hz.
        min_rate: least of the robots' mean rates in bit/s/Hz.
        sic_violations: share of robot-slots whose signal broke Eq. (2).
        projections: share of slots in which the access point changed the picks.
        slots: length of an episode.
        episodes: the same of each episode, arrays; None where rooms were played.
    """

    epsilon: float
    success: float
    path_ratio: float
    reward: float
    ee: float
    ee_bits_per_joule: float
    sum_rate: float
    min_rate: float
    sic_violations: float
    projections: float
    slots: float
    episodes: EpisodeMeasures | None = field(default=None, repr=False)


def evaluate(
    overrides: Overrides, *, episodes: int | None = None, seed: int | None = None
) -> Evaluation:
    """Plays what learns nothing on held-out starts, such as ``baseline=shortest_canonical``.

    Args:
        overrides: see ``train``.
        episodes: how many; ``evaluation.episodes`` if None.
        seed: picks the starts; the configuration's own if None.

    Raises:
        ConfigError: a mistake in the overrides, or something learns with them.
    """
    check_options(episodes=episodes, seed=seed)
    config, robots, ap = without_weights(override_texts(overrides))
    return evaluation_of(config, robots, ap, episodes, 0.0, seed)


def evaluation_of(
    config: Config,
    robots: NDArray[np.float32],
    ap: NDArray[np.float32],
    episodes: int | None,
    epsilon: float,
    seed: int | None,
) -> Evaluation:
    """Plays frozen weights, see ``experiments.analysis.frozen.play``.

    Raises:
        ConfigError: nothing learns, and so nothing explores; or an oracle cannot search this.
    """
    if epsilon and learns_nothing(config):
        raise ConfigError(f"epsilon={epsilon:g}: allowed is 0 where nothing learns.")
    (found,) = play(config, robots, ap, episodes, (epsilon,), seed)
    return Evaluation(epsilon, **found.summary(), episodes=found)
