"""Episodes to show: what a run has learned, and what else drives from the same starts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent import single_threaded
from conf import ConfigError, has_rooms
from conf.user_paths import user_path
from experiments.analysis import played
from experiments.viewer.scene import scene
from training.evaluation import Evaluator
from training.run_folder import RunFolder
from training.trace import recorded

ORACLE, RULE = "oracle", "shortest"
RIVALS = {
    ORACLE: "trajectory oracle: motion, phases and powers planned",
    RULE: "shortest ways, best phases and powers",
}
"""What drives from the same start without learning, by its name on the command line."""

Panel = dict[str, Any]
"""A "title", a "scene" as ``scene.scene``, and an "episode" as ``training.trace.recorded``."""


def beside(
    run: RunFolder, against: Sequence[str], episode: int, epsilon: float = 0.0
) -> list[Panel]:
    """An episode of a run, and what it stands against from the same start.

    Args:
        run: the run's folder.
        against: folders of other runs, or names of ``RIVALS``.
        episode: the number of the held-out start, from 0.
        epsilon: probability of a random action of what has learned.

    Raises:
        ConfigError: see ``of_run`` and ``rival``.
    """
    panels = [of_run(run, episode, epsilon)]
    for other in against:
        if other in RIVALS:
            panels.append(rival(run, episode, other))
        else:
            there = RunFolder.named(user_path(other))
            panels.append(of_run(there, episode, epsilon, start=_start(run, there, episode)))
    return panels


def _start(run: RunFolder, other: RunFolder, episode: int) -> NDArray[np.int64]:
    """The cells that a run's episode starts from, for another run.

    Raises:
        ConfigError: the other run's floor or destinations are not the same.
    """
    one, its = _evaluator(run), _evaluator(other)
    same = np.array_equal(one.world.floor.centres(), its.world.floor.centres())
    if not (same and np.array_equal(one.world.destinations, its.world.destinations)):
        say = "a run on a floor of the same cells, whose robots have the same destinations"
        raise ConfigError(f"--against {other}: allowed is {say}.")
    start: NDArray[np.int64] = one_start(one, episode).starts
    return start


def of_run(
    folder: RunFolder,
    episode: int,
    epsilon: float = 0.0,
    start: NDArray[np.int64] | None = None,
) -> Panel:
    """An episode of a run's final weights.

    Args:
        folder: of a run, or of a room of a building.
        episode: the number of the held-out start, from 0.
        epsilon: probability of a random action.
        start: cells to start from in its place, shape (1, K).

    Raises:
        ConfigError: the folder is none of a run that has ended, or is a building's.
    """
    evaluator = one_start(_evaluator(folder), 0 if start is not None else episode)
    weights = folder.read_weights(evaluator.config)
    if start is not None:
        evaluator.starts = start
    driven = played.learned(evaluator, weights, epsilon)
    explored = f", {epsilon:.0%} random actions" if epsilon else ", greedy"
    return _panel(f"{folder.path.name}: learned{explored}", driven)


def rival(folder: RunFolder, episode: int, name: str) -> Panel:
    """The same episode as driven by one of ``RIVALS``.

    Raises:
        ConfigError: there is no plan, as with fading that changes in each slot.
    """
    evaluator = one_start(_evaluator(folder), episode)
    try:
        driven = played.planned(evaluator) if name == ORACLE else played.ruled(evaluator)
    except ValueError as error:
        raise ConfigError(f"{error}.") from error
    return _panel(RIVALS[name], driven)


def one_start(whole: Evaluator, episode: int) -> Evaluator:
    """One of a run's held-out starts.

    Raises:
        ConfigError: there are not so many.
    """
    if not 0 <= episode < whole.episodes:
        allowed = f"0 to {whole.episodes - 1}, the run's held-out starts"
        raise ConfigError(f"--episode {episode}: allowed is {allowed}.")
    one = Evaluator(whole.config, whole.world.scenario, episodes=1)
    one.starts = whole.starts[episode : episode + 1]
    return one


def _evaluator(folder: RunFolder) -> Evaluator:
    config = folder.read_config()
    if has_rooms(config):
        some = folder.room("0000")
        raise ConfigError(f"{folder}: allowed is one of the building's rooms, such as {some}.")
    single_threaded()
    return Evaluator(config)


def _panel(title: str, driven: played.PlayedEpisodes) -> Panel:
    return {
        "title": title,
        "scene": scene(driven.world.scenario),
        "episode": recorded(driven.along, driven.world, driven.measures),
    }
