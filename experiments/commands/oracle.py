"""``risfleet oracle``: what oracles reach on held-out starts, and a run's gap to them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table
from rich.text import Text

from agent import single_threaded
from conf import Config, ConfigError
from conf.user_paths import user_path
from experiments.analysis import optimality_gap
from experiments.analysis.optimality_gap import SLACK
from experiments.console.arguments import check_place, not_negative, positive, run_folder
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
    try:
        check_place("--json", given.json)
        config, weights = _read(given.what)
        results = compare(config, weights, given.episodes, given.slack, given.seed)
    except ConfigError as error:
        print(f"risfleet: {error}", file=sys.stderr)
        return 2
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
) -> dict[str, Any]:
    """Plays the oracles, and a policy where there is one.

    Args:
        config: the configuration.
        weights: online weights of robots, shape (K, P), and access point, shape (P_AP,), or None.
        episodes: how many held-out episodes.
        slack: extra slots that a planned path may take.
        starts_seed: picks the starts, random phases and the bootstrap; the run's seed if None.

    Returns:
        "measures" of each policy, and with weights the "gap", as ``optimality_gap.gap``.

    Raises:
        ConfigError: the oracles cannot search this configuration.
    """
    single_threaded()
    seed = config.seed if starts_seed is None else starts_seed
    evaluator = Evaluator(config, episodes=episodes, starts_seed=starts_seed)
    try:
        _refuse_fading(config)
        found = {} if weights is None else optimality_gap.policy_measures(evaluator, *weights)
        found |= optimality_gap.shortest_measures(evaluator, seed)
        found[optimality_gap.TRAJECTORY] = optimality_gap.trajectory_measures(
            evaluator, slack, _shown
        )
    except ValueError as error:
        raise ConfigError(f"{error}.") from error
    results: dict[str, Any] = {"measures": {name: one.summary() for name, one in found.items()}}
    if weights is not None:
        results["gap"] = optimality_gap.gap(found, seed)
    return results


def _refuse_fading(config: Config) -> None:
    """Finds before anything is played that no plan can be made."""
    if config.env.channel.fading == "slot":
        raise ValueError(
            "env.channel.fading=slot: allowed is static or none: a plan needs channels that stay"
        )


def _read(
    what: Sequence[str],
) -> tuple[Config, tuple[NDArray[np.float32], NDArray[np.float32]] | None]:
    """The configuration, and a run's weights where a folder is given."""
    folder = run_folder(what)
    if folder is None:
        return checked(list(what)), None
    config = folder.read_config()
    return config, folder.read_weights(config)


def _shown(starts: Iterable[NDArray[np.int64]]) -> Iterable[NDArray[np.int64]]:
    """Shows how many of the episodes are planned."""
    console = Console(stderr=True)
    return track(list(starts), "planning episodes", console=console, transient=True)


def _show(console: Console, title: str, results: dict[str, Any]) -> None:
    table = Table(title=Text(title), title_justify="left")
    table.add_column("")
    for label in COLUMNS.values():
        table.add_column(label, justify="right")
    for name, values in results["measures"].items():
        table.add_row(name, *(_measure(key, values[key]) for key in COLUMNS))
    console.print(table)
    console.print(UNITS, highlight=False)
    if "gap" not in results:
        return
    parts = Table(title="what the policy leaves of the trajectory's EE", title_justify="left")
    for name in ("", "EE (bit/s/Hz/J)", "95 % interval", "share"):
        parts.add_column(name, justify="right" if name else "left")
    for name, part in results["gap"].items():
        interval = f"{part['low']:.4f} to {part['high']:.4f}"
        parts.add_row(name, f"{part['mean']:.4f}", interval, f"{part['share']:.1%}")
    console.print(parts)
    console.print(f"Parts {ORDER}, best motion.", highlight=False)


def _measure(key: str, value: float) -> str:
    if value != value:
        return "-"
    return format(value, ".4f" if key == "ee" else ".3f")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("risfleet oracle", description=__doc__)
    parser.add_argument(
        "what", nargs="*", metavar="RUN | KEY=VALUE", help="a run's folder, or keys to set"
    )
    parser.add_argument("--episodes", type=positive, default=EPISODES, help="held-out episodes")
    parser.add_argument(
        "--slack", type=not_negative, default=SLACK, help="extra slots of a planned path"
    )
    parser.add_argument(
        "--seed", type=not_negative, help="seed of the held-out starts, if not the run's"
    )
    parser.add_argument(
        "--json", type=user_path, metavar="FILE", help="write the measures there too"
    )
    return parser
