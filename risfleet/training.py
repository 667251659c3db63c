"""Training from Python: what ``risfleet train`` does, by the same functions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import conf
from conf import Config, ConfigError
from conf.python_values import Overrides, grid_texts, override_texts
from experiments.batch import train as batch
from experiments.batch.states import folder_of
from experiments.batch.sweeps import planned_sweep, train_in_turn
from experiments.console.screen import Reporter, screen_of
from experiments.runtimes.runner import planned
from experiments.runtimes.runner import train as train_run
from experiments.runtimes.stopping import pass_on
from risfleet.runs import Run

if TYPE_CHECKING:
    from env import RISFleetParallelEnv


class SweepError(RuntimeError):
    """Some runs of a sweep failed.

    Attributes:
        runs: those that are there.
        failed: why the others are not, by folder.
    """

    def __init__(self, runs: list[Run], failed: Mapping[Path, str]) -> None:
        super().__init__("\n".join(f"{folder} failed: {why}" for folder, why in failed.items()))
        self.runs, self.failed = runs, dict(failed)


def compose(overrides: Overrides = ()) -> Config:
    """The configuration that overrides describe, checked.

    Args:
        overrides: a text, texts such as ``"env.robots=4"``, or keys with their values.

    Raises:
        ConfigError: a wrong key, value or combination.
    """
    return conf.compose(override_texts(overrides))


def make_env(overrides: Overrides = (), *, render_mode: str | None = None) -> RISFleetParallelEnv:
    """The world that overrides describe, as a PettingZoo environment.

    Args:
        overrides: see ``compose``; keys of ``env``, and ``seed``.
        render_mode: see ``RISFleetParallelEnv``.

    Raises:
        ConfigError: a wrong key, value or combination.
    """
    from env import RISFleetParallelEnv

    config = compose(overrides)
    return RISFleetParallelEnv(config.env, seed=config.seed, render_mode=render_mode)


def train(overrides: Overrides = (), *, progress: bool | Reporter = True) -> Run:
    """Trains a run, whatever its runtime, and waits for its end.

    Ctrl-C, a kernel's interrupt or SIGTERM end the run at its next aggregation, and what it has
    learned is kept: ``Run.stopped_early`` says so, and ``train({"resume": run.path})`` goes on.
    A second one ends it at once. SIGTERM then ends the process as it would have before. Both reach
    a run in the main thread alone; elsewhere a file named ``stop`` in its folder does the same.

    Numerical libraries are held to one thread in this process, for speed and for equal bits.

    Args:
        overrides: a text, texts such as ``"env.robots=4"``, or keys with their values, such as
            ``{"env.robots": 4, "experiment": "quick"}``; ``resume`` names the folder of a run that
            goes on.
        progress: True shows it on the terminal or in the notebook's cell, False shows nothing. A
            function is called with it, in a thread of its own, whenever it has changed: a mapping
            with ``state``, ``episode`` of ``episodes``, ``tick``, ``success``, ``steps_per_s`` and
            what else ``progress.json`` of the run holds.

    Returns:
        The run.

    Raises:
        ConfigError: a mistake in the overrides, in the command's words; nothing has been started.
            It is a ``ValueError``, as are those of plug-ins.
        OSError: the machine, its disk or network failed; other errors name Flower's part in it.
    """
    config, folder, checkpoint = planned(override_texts(overrides))
    stop = train_run(config, folder, checkpoint, screen_of(progress))
    pass_on(stop.status)
    return Run(folder.absolute())


def sweep(
    overrides: Overrides = (),
    grid: Mapping[str, Iterable[Any]] | None = None,
    *,
    jobs: int | None = None,
    progress: bool = True,
) -> list[Run]:
    """Trains a run for each combination of values, all of them checked before the first starts.

    They lie in the folders 0, 1, ... of the sweep's, which is ``run.dir``, or a new one in
    ``multirun``. The same call with that ``run.dir`` does what is missing: runs that have ended are
    left as they are, begun ones go on. Signals: see ``train``; those runs come back that are there.

    Args:
        overrides: what all runs have in common, see ``train``; also ``hydra/launcher``.
        grid: from a key, or a group, to its values; the last key varies fastest.
        jobs: runs at once, in processes of their own, as many as cores if None; with 1 they follow
            one another in this process.
        progress: whether it is shown.

    Returns:
        The runs, in the order of the combinations.

    Raises:
        ConfigError: a mistake in any combination; nothing has been started.
        SweepError: runs failed; all others have been trained.
    """
    if jobs is not None and (isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1):
        raise ConfigError(f"jobs={jobs!r}: allowed is None or a whole number of at least 1.")
    screen = screen_of(bool(progress))
    with planned_sweep([*override_texts(overrides), *grid_texts(grid or {})]) as planned_runs:
        configs = planned_runs.configs
        if jobs == 1 and not planned_runs.launcher:
            outcome = train_in_turn(configs, screen, lambda error: None)
        else:
            place, launcher = planned_runs.folder, planned_runs.launcher
            outcome = batch.train(configs, place, screen.console, launcher, jobs)
    pass_on(outcome.status)
    done = [Run(place) for place in map(folder_of, configs) if place in outcome.done]
    if outcome.failed:
        raise SweepError(done, outcome.failed)
    return done
