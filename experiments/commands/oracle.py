"""``risfleet oracle``: what oracles reach on held-out starts, and a run's gap to them.

With ``--measured`` plans on the map that robots measured stand beside them.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from agent import single_threaded
from conf import Config, ConfigError
from conf.user_paths import user_path
from env.radio.measured_map import refuse
from experiments.analysis import measured_map, optimality_gap
from experiments.analysis.optimality_gap import SLACK
from experiments.console.arguments import (
    check_place,
    deviation_db,
    not_negative,
    positive,
    run_folder,
)
from experiments.console.display import measure, table
from storage.atomic import write_atomically
from storage.strict_json import to_json
from training.evaluation import Evaluator
from training.preflight import checked

EPISODES = 20
COLUMNS = {
    "ee": "EE",
    "ee_bits_per_joule": "bit/J",
    "sum_rate": "sum",
    "min_rate": "min",
    "success": "success",
    "path_ratio": "path",
}
UNITS = (
    "EE in bit/s/Hz/J; sum and min: sum rate and least mean rate in bit/s/Hz;\n"
    "path: slots driven over the fewest possible.\n"
    "Shortest ways have canonical powers, or best phases and powers (best powers)."
)
ORDER = "in this order: best phases for the policy's motion and power picks, best powers as well"


def main(arguments: Sequence[str]) -> int:
    """Runs the command; returns the exit status."""
    given = _parser().parse_args(arguments)
    check_place("--json", given.json)
    if given.noise_db and not given.measured:
        raise ConfigError(f"--noise-db {given.noise_db:g}: allowed is 0 without --measured.")
    folder = run_folder(given.what)
    config = checked(given.what) if folder is None else folder.read_config()
    weights = None if folder is None else folder.read_weights(config)
    gathering = sorted(set(given.measured)), given.noise_db
    results = compare(config, weights, given.episodes, given.slack, given.seed, gathering)
    title = f"{' '.join(given.what) or 'defaults'}: {given.episodes} held-out episodes"
    _show(Console(), title, results)
    if given.json:
        write_atomically(given.json, to_json(results))
    return 0


def compare(
    config: Config,
    weights: tuple[NDArray[np.float32], NDArray[np.float32]] | None,
    episodes: int = EPISODES,
    slack: int = SLACK,
    starts_seed: int | None = None,
    gathering: tuple[Sequence[int], float] = ((), 0.0),
) -> dict[str, Any]:
    """Plays the oracles, and a policy where there is one.

    Args:
        config: the configuration.
        weights: online weights of robots, shape (K, P), and access point, shape (P_AP,), or None.
        episodes: how many held-out episodes.
        slack: extra slots that a planned path may take.
        starts_seed: picks the starts, random phases and the bootstrap; the run's seed if None.
        gathering: numbers of episodes after which to plan on the measured map, and the standard
            deviation of a measured gain in dB.

    Returns:
        "measures" of each policy; with weights the "gap", as ``optimality_gap.gap``; with
        gathering what was "measured", as ``measured_map.measures``, and the share of the
        trajectory's EE.

    Raises:
        ConfigError: the oracles cannot search this configuration.
    """
    single_threaded()
    seed = config.seed if starts_seed is None else starts_seed
    evaluator = Evaluator(config, episodes=episodes, starts_seed=starts_seed)
    try:
        _refuse(config, measured=bool(gathering[0]))
        found = {} if weights is None else optimality_gap.policy_measures(evaluator, *weights)
        found |= optimality_gap.shortest_measures(evaluator, seed)
        found[optimality_gap.TRAJECTORY] = optimality_gap.trajectory_measures(
            evaluator, slack, _shown
        )
        measured = _measured(evaluator, config.seed, gathering, slack, found)
    except ValueError as error:
        raise ConfigError(f"{error}.") from error
    results: dict[str, Any] = {"measures": {name: one.summary() for name, one in found.items()}}
    if weights is not None:
        results["gap"] = optimality_gap.gap(found, seed)
    if measured:
        results["measured"] = measured
    return results


def _measured(
    evaluator: Evaluator,
    seed: int,
    gathering: tuple[Sequence[int], float],
    slack: int,
    found: optimality_gap.Measures,
) -> dict[str, measured_map.Figures]:
    """Adds the plans on measured maps to what was found; figures by the name of the row."""
    if not gathering[0]:
        return {}
    played, figures = measured_map.measures(evaluator, seed, *gathering, slack, _shown)
    best, named = found[optimality_gap.TRAJECTORY].ee.mean(), {}
    for number, measures in played.items():
        name = f"measured, {number} episode{'s' * (number > 1)}"
        found[name], named[name] = measures, figures[number]
        named[name]["share"] = float(measures.ee.mean() / best)
    return named


def _refuse(config: Config, measured: bool) -> None:
    """Finds before anything is played that no plan can be made, or no map be measured."""
    if config.env.channel.fading == "slot":
        raise ValueError(
            "env.channel.fading=slot: allowed is static or none: a plan needs channels that stay"
        )
    if measured:
        refuse(config.env.ris)


def _shown(starts: Iterable[NDArray[np.int64]]) -> Iterable[NDArray[np.int64]]:
    """Shows how many of the episodes are planned."""
    console = Console(stderr=True)
    return track(list(starts), "planning episodes", console=console, transient=True)


def _show(console: Console, title: str, results: dict[str, Any]) -> None:
    rows: Iterable[Sequence[str]] = (
        (name, *(measure(key, values[key]) for key in COLUMNS))
        for name, values in results["measures"].items()
    )
    console.print(table(title, ("", *COLUMNS.values()), rows))
    console.print(UNITS, highlight=False)
    if "measured" in results:
        rows = (
            (name, f"{one['share']:.1%}", f"{one['cells_seen']:.1%}", f"{one['bytes_up']:,}")
            for name, one in results["measured"].items()
        )
        columns = ("", "of the trajectory's EE", "cells seen", "bytes up")
        console.print(table("plans on the map that robots measured", columns, rows))
        say = "Measured before these episodes; nothing learns from rewards."
        console.print(say, highlight=False)
    if "gap" in results:
        rows = (
            (
                name,
                f"{part['mean']:.4f}",
                f"{part['low']:.4f} to {part['high']:.4f}",
                f"{part['share']:.1%}",
            )
            for name, part in results["gap"].items()
        )
        columns = ("", "EE (bit/s/Hz/J)", "95 % interval", "share")
        console.print(table("what the policy leaves of the trajectory's EE", columns, rows))
        console.print(f"Parts {ORDER}, best motion.", highlight=False)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("risfleet oracle", description=__doc__)
    say = "a run's folder, or keys to set"
    parser.add_argument("what", nargs="*", metavar="RUN | KEY=VALUE", help=say)
    parser.add_argument("--episodes", type=positive, default=EPISODES, help="held-out episodes")
    say = "extra slots of a planned path"
    parser.add_argument("--slack", type=not_negative, default=SLACK, help=say)
    say = "seed of the held-out starts, if not the run's"
    parser.add_argument("--seed", type=not_negative, help=say)
    say = "plan on the map measured in N episodes, too"
    parser.add_argument("--measured", type=positive, nargs="+", default=[], metavar="N", help=say)
    say = "standard deviation of a measured gain in dB"
    parser.add_argument("--noise-db", type=deviation_db, default=0.0, help=say)
    say = "write the measures there too"
    parser.add_argument("--json", type=user_path, metavar="FILE", help=say)
    return parser
