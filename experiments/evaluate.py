"""``risfleet evaluate RUN``: plays a run's frozen weights on held-out starts."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from safetensors import SafetensorError
from safetensors.numpy import load_file

from agent import single_threaded
from conf import Config, ConfigError, ap_network, from_yaml, robot_network
from experiments.display import evaluation_table
from server_app.evaluation import Evaluator
from server_app.recorder import write_atomically
from server_app.session import to_json

EPSILONS = (0.0, 0.05)


def main(arguments: Sequence[str]) -> int:
    """Runs the command; returns the exit status."""
    given = _parser().parse_args(arguments)
    folder = Path(given.run)
    try:
        config = _read_config(folder)
        robots, ap = read_weights(folder, config)
        if given.json and not Path(given.json).absolute().parent.is_dir():
            raise ConfigError(f"--json {given.json}: allowed is a file in a folder that exists.")
    except ConfigError as error:
        print(f"risfleet: {error}", file=sys.stderr)
        return 2
    if given.seed is not None:
        config = dataclasses.replace(config, seed=given.seed)
    results = evaluate(config, robots, ap, given.episodes, given.epsilon or EPSILONS)
    title = f"{folder}: {given.episodes or config.evaluation.episodes} held-out episodes"
    Console().print(evaluation_table(title, results))
    if given.json:
        write_atomically(Path(given.json), to_json(results))
    return 0


def evaluate(
    config: Config,
    robots: NDArray[np.float32],
    ap: NDArray[np.float32],
    episodes: int | None,
    epsilons: Sequence[float],
) -> dict[str, dict[str, float]]:
    """Plays frozen weights.

    Args:
        config: the run's configuration; its seed picks the held-out starts.
        robots: online weights of each robot, shape (K, P).
        ap: online weights of the access point, shape (P_AP,).
        episodes: how many; ``config.evaluation.episodes`` if None.
        epsilons: explorations to play with.

    Returns:
        From a column's name to its measures.
    """
    single_threaded()
    evaluator = Evaluator(config, episodes=episodes)
    measures = evaluator.play(robots, ap, epsilons)
    return {
        f"eps = {epsilon:g}": found.summary()
        for epsilon, found in zip(epsilons, measures, strict=True)
    }


def read_weights(folder: Path, config: Config) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The online weights that a run has written: robots (K, P) and access point (P_AP,).

    Raises:
        ConfigError: they are missing, damaged or of another size than the configuration's.
    """
    path = folder / "weights.safetensors"
    try:
        arrays = load_file(path)
    except FileNotFoundError as error:
        raise ConfigError(f"{path} is missing: has the run ended?") from error
    except SafetensorError as error:
        raise ConfigError(f"{path} is damaged: {error}.") from error
    expected = {
        "robots": (config.env.robots, 2, robot_network(config).parameters),
        "ap": (2, ap_network(config).parameters),
    }
    for name, shape in expected.items():
        if name not in arrays or arrays[name].shape != shape:
            found = arrays[name].shape if name in arrays else "nothing"
            raise ConfigError(f"{path}: {name} is {found} where config.yaml says {shape}.")
    return arrays["robots"][:, 0], arrays["ap"][0]


def _read_config(folder: Path) -> Config:
    path = folder / "config.yaml"
    try:
        return from_yaml(path.read_text())
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{folder} is no run folder: {path.name} cannot be read.") from error


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("risfleet evaluate", description=__doc__)
    parser.add_argument("run", help="the run's folder")
    parser.add_argument("--episodes", type=_positive, help="held-out episodes to play")
    parser.add_argument(
        "--epsilon", type=_share, action="append", help="exploration; may be given again"
    )
    parser.add_argument(
        "--seed", type=_not_negative, help="seed of the held-out starts, if not the run's"
    )
    parser.add_argument("--json", metavar="FILE", help="write the measures there too")
    return parser


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text}: allowed is a number of at least 1")
    return value


def _not_negative(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text}: allowed is a number of at least 0")
    return value


def _share(text: str) -> float:
    value = float(text)
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text}: allowed is a number from 0 to 1")
    return value
