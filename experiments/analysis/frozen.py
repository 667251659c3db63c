"""Frozen weights, or what learns nothing, on held-out starts of a run."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent import single_threaded
from conf import Config, ConfigError, learns_nothing, weight_shapes
from env.episode import EpisodeMeasures
from env.validate import Problem
from training.evaluation import Evaluator
from training.preflight import checked


def play(
    config: Config,
    robots: NDArray[np.float32],
    ap: NDArray[np.float32],
    episodes: int | None,
    epsilons: Sequence[float],
    starts_seed: int | None = None,
) -> list[EpisodeMeasures]:
    """Plays frozen weights.

    Args:
        config: the run's configuration.
        robots: online weights of each robot, shape (K, P).
        ap: online weights of the access point, shape (P_AP,).
        episodes: how many; ``config.evaluation.episodes`` if None.
        epsilons: explorations to play with.
        starts_seed: picks the held-out starts and the exploration; the run's seed if None.

    Returns:
        The measures for each epsilon, an entry an episode.

    Raises:
        ConfigError: an oracle cannot search this configuration.
    """
    single_threaded()
    evaluator = Evaluator(config, episodes=episodes, starts_seed=starts_seed)
    return played_by(evaluator, robots, ap, epsilons)


def played_by(
    evaluator: Evaluator,
    robots: NDArray[np.float32],
    ap: NDArray[np.float32],
    epsilons: Sequence[float],
) -> list[EpisodeMeasures]:
    """``Evaluator.play``; that an oracle cannot search the configuration is a ConfigError."""
    try:
        return evaluator.play(robots, ap, epsilons)
    except ValueError as error:
        raise ConfigError(f"{error}.") from error


def without_weights(
    overrides: Sequence[str],
) -> tuple[Config, NDArray[np.float32], NDArray[np.float32]]:
    """A configuration in which nothing learns, and the empty weights that ``play`` takes with it.

    Raises:
        ConfigError: a mistake in it, or something learns.
    """
    config = checked(overrides)
    if not learns_nothing(config):
        raise ConfigError(
            f"{' '.join(overrides)}: allowed without a run's folder is what learns nothing, such as"
            " baseline=shortest_canonical."
        )
    shapes = weight_shapes(config)
    none = {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}
    return config, none["robots"][:, 0], none["ap"][0]


def check_options(**options: Any) -> None:
    """Checks options of an evaluation that come from Python, None being none.

    Args:
        options: by name: ``epsilon`` from 0 to 1, ``episodes`` of at least 1, and others, which
            are whole numbers of at least 0.

    Raises:
        ConfigError: names each one that cannot be.
    """
    found: list[Problem] = []
    for name, value in options.items():
        if name == "epsilon":
            good = isinstance(value, Real) and 0 <= float(value) <= 1
            allowed = "a number from 0 to 1"
        else:
            least = 1 if name == "episodes" else 0
            good = isinstance(value, Integral) and int(value) >= least
            allowed = f"a whole number of at least {least}"
        if value is not None and (isinstance(value, bool) or not good):
            found.append((name, value, allowed))
    if found:
        raise ConfigError.of(found)
