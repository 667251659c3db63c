"""``risfleet evaluate``: plays frozen weights, or what learns nothing, on held-out starts."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from rich.console import Console

from agent import single_threaded
from conf import Config, ConfigError, has_rooms, learns_nothing
from conf.user_paths import user_path
from experiments.analysis import rooms
from experiments.analysis.frozen import play, without_weights
from experiments.console.arguments import check_place, not_negative, positive, run_folder, share
from experiments.console.display import evaluation_table
from storage.atomic import write_atomically
from storage.strict_json import to_json

EPSILONS = (0.0, 0.05)


def main(arguments: Sequence[str]) -> int:
    """Runs the command; returns the exit status."""
    given = _parser().parse_args(arguments)
    check_place("--json", given.json)
    config, results = _results(given)
    episodes = given.episodes or config.evaluation.episodes
    each = " in each room" if has_rooms(config) else ""
    title = f"{' '.join(given.what)}: {episodes} held-out episodes{each}"
    Console().print(evaluation_table(title, results))
    if given.json:
        write_atomically(given.json, to_json(results))
    return 0


def _results(given: argparse.Namespace) -> tuple[Config, dict[str, dict[str, float]]]:
    """The configuration of what is played, and the table's columns."""
    folder = run_folder(given.what)
    if folder is not None and has_rooms(config := folder.read_config()):
        single_threaded()
        epsilons = given.epsilon or EPSILONS[:1]
        wanted = (given.episodes, epsilons, given.seed, given.personalise)
        return config, rooms.columns(folder, config, *wanted)
    if given.personalise:
        raise ConfigError("--personalise is for the run of a building: allowed is none here.")
    if folder is not None:
        robots, ap = folder.read_weights(config)
    else:
        config, robots, ap = without_weights(given.what)
    epsilons = _epsilons(config, given.epsilon)
    measures = play(config, robots, ap, given.episodes, epsilons, given.seed)
    return config, {
        f"eps = {epsilon:g}": found.summary()
        for epsilon, found in zip(epsilons, measures, strict=True)
    }


def _epsilons(config: Config, given: Sequence[float] | None) -> Sequence[float]:
    """The explorations to play with."""
    if not learns_nothing(config):
        return given or EPSILONS
    if given and any(given):
        raise ConfigError(f"--epsilon {max(given):g}: allowed is 0 where nothing learns.")
    return (0.0,)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("risfleet evaluate", description=__doc__)
    say = "a run's folder or its file of weights, or keys to set of what learns nothing"
    parser.add_argument("what", nargs="+", metavar="RUN | KEY=VALUE", help=say)
    parser.add_argument("--episodes", type=positive, help="held-out episodes to play")
    say = "exploration; may be given again"
    parser.add_argument("--epsilon", type=share, action="append", help=say)
    say = "seed of the held-out starts, if not the run's"
    parser.add_argument("--seed", type=not_negative, help=say)
    say = "of a building: let each room learn on by itself, and play it once more"
    parser.add_argument("--personalise", type=positive, default=0, metavar="TICKS", help=say)
    say = "write the measures there too"
    parser.add_argument("--json", type=user_path, metavar="FILE", help=say)
    return parser
