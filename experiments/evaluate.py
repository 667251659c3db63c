"""``risfleet evaluate``: plays frozen weights, or what learns nothing, on held-out starts."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from safetensors import SafetensorError
from safetensors.numpy import load_file

from agent import single_threaded
from conf import Config, ConfigError, from_yaml, learns_nothing, weight_shapes
from conf.user_paths import user_path
from env.texts import read_text
from experiments.display import evaluation_table
from server_app.evaluation import Evaluator
from server_app.files import to_json, write_atomically
from server_app.preflight import checked

EPSILONS = (0.0, 0.05)


def main(arguments: Sequence[str]) -> int:
    """Runs the command; returns the exit status."""
    given = _parser().parse_args(arguments)
    try:
        config, robots, ap = _read(given.what)
        epsilons = _epsilons(config, given.epsilon)
        check_place("--json", given.json)
        results = evaluate(config, robots, ap, given.episodes, epsilons, given.seed)
    except ConfigError as error:
        print(f"risfleet: {error}", file=sys.stderr)
        return 2
    episodes = given.episodes or config.evaluation.episodes
    title = f"{' '.join(given.what)}: {episodes} held-out episodes"
    Console().print(evaluation_table(title, results))
    if given.json:
        write_atomically(given.json, to_json(results))
    return 0


def evaluate(
    config: Config,
    robots: NDArray[np.float32],
    ap: NDArray[np.float32],
    episodes: int | None,
    epsilons: Sequence[float],
    starts_seed: int | None = None,
) -> dict[str, dict[str, float]]:
    """Plays frozen weights.

    Args:
        config: the run's configuration.
        robots: online weights of each robot, shape (K, P).
        ap: online weights of the access point, shape (P_AP,).
        episodes: how many; ``config.evaluation.episodes`` if None.
        epsilons: explorations to play with.
        starts_seed: picks the held-out starts and the exploration; the run's seed if None.

    Returns:
        From a column's name to its measures.

    Raises:
        ConfigError: an oracle cannot search this configuration.
    """
    single_threaded()
    evaluator = Evaluator(config, episodes=episodes, starts_seed=starts_seed)
    try:
        measures = evaluator.play(robots, ap, epsilons)
    except ValueError as error:
        raise ConfigError(f"{error}.") from error
    return {
        f"eps = {epsilon:g}": found.summary()
        for epsilon, found in zip(epsilons, measures, strict=True)
    }


def _read(what: Sequence[str]) -> tuple[Config, NDArray[np.float32], NDArray[np.float32]]:
    """A run's configuration and online weights; or a configuration in which nothing learns."""
    folder = run_folder(what)
    if folder is not None:
        config = read_config(folder)
        return config, *read_weights(folder, config)
    config = checked(what)
    if not learns_nothing(config):
        raise ConfigError(
            f"{' '.join(what)}: allowed without a run's folder is what learns nothing, such as"
            " baseline=shortest_canonical."
        )
    shapes = weight_shapes(config)
    none = {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}
    return config, none["robots"][:, 0], none["ap"][0]


def run_folder(what: Sequence[str]) -> Path | None:
    """The run's folder that arguments name; None where they set keys.

    Raises:
        ConfigError: there are keys beside it.
    """
    folders = [user_path(item) for item in what if "=" not in item or user_path(item).is_dir()]
    if folders and len(what) > 1:
        raise ConfigError(f"{' '.join(what)}: allowed is one run folder, or KEY=VALUE ... alone.")
    return folders[0] if folders else None


def _epsilons(config: Config, given: Sequence[float] | None) -> Sequence[float]:
    """The explorations to play with."""
    if not learns_nothing(config):
        return given or EPSILONS
    if given and any(given):
        raise ConfigError(f"--epsilon {max(given):g}: allowed is 0 where nothing learns.")
    return (0.0,)


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
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror or error}.") from error
    for name, shape in weight_shapes(config).items():
        if name not in arrays or arrays[name].shape != shape:
            found = arrays[name].shape if name in arrays else "nothing"
            raise ConfigError(f"{path}: {name} is {found} where config.yaml says {shape}.")
    return arrays["robots"][:, 0], arrays["ap"][0]


def read_config(folder: Path) -> Config:
    """The configuration that a run has written.

    Raises:
        ConfigError: it is not there, or wrong.
    """
    path = folder / "config.yaml"
    try:
        return from_yaml(read_text(path))
    except UnicodeError as error:
        raise ConfigError(f"{path} cannot be read: {error}.") from error
    except OSError as error:
        raise ConfigError(f"{folder} is no run folder: {path.name} cannot be read.") from error


def check_place(option: str, file: Path | None) -> None:
    """Finds a place where no file can be written before anything is worked out.

    Raises:
        ConfigError: the option's file is a folder, or in none that can be written to.
    """
    if file is None:
        return
    if file.is_dir() or not file.absolute().parent.is_dir():
        raise ConfigError(f"{option} {file}: allowed is a file in a folder that exists.")
    if not os.access(file.absolute().parent, os.W_OK):
        raise ConfigError(f"{option} {file}: allowed is a file in a folder that can be written to.")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("risfleet evaluate", description=__doc__)
    parser.add_argument(
        "what",
        nargs="+",
        metavar="RUN | KEY=VALUE",
        help="a run's folder, or keys to set of what learns nothing",
    )
    parser.add_argument("--episodes", type=positive, help="held-out episodes to play")
    parser.add_argument(
        "--epsilon", type=_share, action="append", help="exploration; may be given again"
    )
    parser.add_argument(
        "--seed", type=not_negative, help="seed of the held-out starts, if not the run's"
    )
    parser.add_argument(
        "--json", type=user_path, metavar="FILE", help="write the measures there too"
    )
    return parser


def positive(text: str) -> int:
    """An option's whole number of at least 1."""
    return int(_number(text, int, 1, math.inf, "a whole number of at least 1"))


def not_negative(text: str) -> int:
    """An option's whole number of at least 0."""
    return int(_number(text, int, 0, math.inf, "a whole number of at least 0"))


def _share(text: str) -> float:
    return _number(text, float, 0, 1, "a number from 0 to 1")


def _number(
    text: str, kind: Callable[[str], float], low: float, high: float, allowed: str
) -> float:
    """Reads a number for argparse, which would name the function that fails with ValueError."""
    try:
        value = kind(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text}: allowed is {allowed}")
    return value
