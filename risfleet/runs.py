"""A run that has been trained: what its folder holds, and what its weights are worth."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from conf import Config, ConfigError, has_rooms
from conf.user_paths import user_path
from experiments.analysis import rooms
from experiments.analysis.frozen import check_options
from experiments.console.display import describe, summary_table
from experiments.console.mishaps import in_words
from experiments.viewer.replays import beside
from risfleet.evaluation import Evaluation, evaluation_of
from risfleet.replays import Replay
from training.policy import AccessPointPolicy, Policy
from training.recording.csv_log import read_columns
from training.rooms import known_rooms
from training.run_folder import RunFolder

if TYPE_CHECKING:
    import pandas as pd

    from env import RISFleetParallelEnv


class Run:
    """A run's folder. What it holds is read when it is asked for.

    Args:
        path: the folder.

    Attributes:
        path: its absolute path.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path).absolute()
        self._folder = RunFolder(self.path)

    # --- What it holds ----------------------------------------------------------------------------

    @cached_property
    def config(self) -> Config:
        """The configuration that it was trained with."""
        return self._folder.read_config()

    @property
    def summary(self) -> dict[str, Any]:
        """What ``summary.json`` holds: digests, measures, costs, versions.

        Raises:
            ConfigError: the run has not ended, or the file is damaged.
        """
        try:
            return self._folder.read_summary()
        except (OSError, ValueError) as error:
            file = self._folder.summary_file
            raise ConfigError(f"{file} cannot be read: has the run ended?") from error

    @property
    def stopped_early(self) -> bool:
        """Whether a signal or a file named ``stop`` ended it."""
        return bool(self.summary["stopped_early"])

    @property
    def metrics(self) -> pd.DataFrame | dict[str, NDArray[Any]]:
        """A training episode a row: ``episode``, ``tick``, ``success``, ``reward``, ``ee``, ...

        A ``pandas.DataFrame`` where pandas is installed, otherwise a dictionary from a column's
        name to its values; ``run.metrics["success"]`` works with both.
        """
        return _table(self._folder.metrics_file)

    @property
    def evaluations(self) -> pd.DataFrame | dict[str, NDArray[Any]]:
        """Two rows an evaluation in training, with exploration and greedy; see ``metrics``."""
        return _table(self._folder.evaluations_file)

    @property
    def rooms(self) -> dict[str, Run]:
        """The rooms of a building by name, each a run of its own; empty without."""
        if not has_rooms(self.config):
            return {}
        names = [room.name for room in known_rooms(self.config, self._folder)]
        return {name: Run(self._folder.room(name).path) for name in names}

    # --- What it has learned ----------------------------------------------------------------------

    @cached_property
    def policy(self) -> Policy:
        """Its final weights, to act with.

        Raises:
            ConfigError: it has not ended, its weights are damaged, or it is a building's.
        """
        if has_rooms(self.config):
            raise ConfigError(f"{self.path}: allowed is a room's policy: Run.rooms[NAME].policy.")
        return Policy(self.config, *self._folder.read_weights(self.config))

    @property
    def access_point(self) -> AccessPointPolicy:
        """The access point's network, to act with.

        Raises:
            ConfigError: it has none; otherwise as ``policy``.
        """
        return self.policy.access_point

    def make_env(self, *, render_mode: str | None = None) -> RISFleetParallelEnv:
        """The world that it was trained in, as a PettingZoo environment."""
        from env import RISFleetParallelEnv

        return RISFleetParallelEnv(self.config.env, seed=self.config.seed, render_mode=render_mode)

    def evaluate(
        self, *, episodes: int | None = None, epsilon: float = 0.0, seed: int | None = None
    ) -> Evaluation:
        """Plays the frozen weights on held-out starts, as ``risfleet evaluate`` does.

        Args:
            episodes: how many; ``config.evaluation.episodes`` if None.
            epsilon: probability of a random action.
            seed: picks starts and exploration; the run's own if None.

        Raises:
            ConfigError: an option that cannot be, weights that cannot be read, or a building, of
                which ``evaluate_rooms`` plays the rooms.
        """
        check_options(episodes=episodes, epsilon=epsilon, seed=seed)
        if has_rooms(self.config):
            raise ConfigError(f"{self.path} has rooms: allowed is Run.evaluate_rooms.")
        weights = self._folder.read_weights(self.config)
        return evaluation_of(self.config, *weights, episodes, epsilon, seed)

    def evaluate_rooms(
        self,
        *,
        episodes: int | None = None,
        epsilon: float = 0.0,
        seed: int | None = None,
        personalise: int = 0,
    ) -> dict[str, Evaluation]:
        """Plays a building's frozen weights in all its rooms, as ``risfleet evaluate`` does.

        Args:
            episodes: how many in each room; ``config.evaluation.episodes`` if None.
            epsilon: probability of a random action.
            seed: picks starts and exploration; each room's own if None.
            personalise: ticks for which each room learns on by itself, to be played once more.

        Returns:
            Means over rooms, each counted alike: of those ``trained in``, those ``held out``, and
            with ``personalise`` of both ``..., personalised``.

        Raises:
            ConfigError: an option that cannot be, a run that has no rooms, or has not ended.
        """
        check_options(episodes=episodes, epsilon=epsilon, seed=seed, personalise=personalise)
        if not has_rooms(self.config):
            raise ConfigError(f"{self.path} has no rooms: allowed is Run.evaluate.")
        wanted = (episodes, (epsilon,), seed, personalise)
        found = rooms.columns(self._folder, self.config, *wanted)
        return {
            name: Evaluation(epsilon, episodes=None, **measures) for name, measures in found.items()
        }

    def replay(
        self,
        *,
        against: Path | str | Sequence[Path | str] = (),
        episode: int = 0,
        epsilon: float = 0.0,
    ) -> Replay:
        """An episode of its final weights, to look at: a notebook's cell plays it.

        Args:
            against: what stands beside it from the same start: folders of other runs, "oracle", or
                "shortest"; one, or several.
            episode: the number of the held-out start, from 0.
            epsilon: probability of a random action.

        Raises:
            ConfigError: it has not ended, is a building's, or has not so many held-out starts.
        """
        check_options(epsilon=epsilon, episode=episode)
        several = [against] if isinstance(against, str | Path) else against
        others = [os.fspath(each) for each in several]
        return Replay(f"RISFleet: {self.path.name}", beside(self._folder, others, episode, epsilon))

    # --- How it is shown --------------------------------------------------------------------------

    def __repr__(self) -> str:
        """Its folder, and where it is if it has not ended."""
        status, here = self._folder.read_progress(), Path.cwd()
        near = self.path.relative_to(here) if self.path.is_relative_to(here) else self.path
        going = status is not None and status["state"] != "done"
        figures = [" ".join(pair).strip() for pair in describe(status)] if status and going else []
        return f"<Run {', '.join([str(near), *figures])}>"

    def _repr_html_(self) -> str | None:
        """A table of what its final weights are worth; None before its end."""
        if not self._folder.summary_file.is_file():
            return None
        html: str = summary_table(self.summary)._repr_mimebundle_((), ())["text/html"]
        return html


def load(path: str | os.PathLike[str]) -> Run:
    """A run that has been trained, or is being trained; or weights that come with RISFleet.

    Args:
        path: the run's folder, such as ``runs/NAME`` or ``results/weights/k4-best``.

    Raises:
        ConfigError: it is no run's folder, or another version's.
    """
    run = Run(RunFolder.named(user_path(os.fspath(path))).path)
    assert run.config is not None  # reads it, and so refuses a folder of something else
    return run


def _table(path: Path) -> pd.DataFrame | dict[str, NDArray[Any]]:
    """A CSV file of a run.

    Raises:
        ConfigError: it cannot be read.
    """
    try:
        columns: Mapping[str, NDArray[Any]] = read_columns(path)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{in_words(error)}: allowed is a run that records it.") from error
    try:
        import pandas as pd
    except ImportError:
        return dict(columns)
    return pd.DataFrame(columns)
