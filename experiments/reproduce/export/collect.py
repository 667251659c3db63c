"""``python -m experiments.reproduce.export``: what of a reproduction is kept in ``results/``.

Copies the files of each target that is there, with its manifest; the weights of a few runs, each in
a folder that ``risfleet evaluate`` takes; a model card; and the first episodes of a run a target,
for a test that runs them again. Nothing that is copied names a folder of this machine.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from conf import ConfigError, has_rooms
from conf.schema import RunConfig
from conf.user_paths import user_path
from experiments.console.mishaps import in_words
from experiments.reproduce.export import hub, repeat
from experiments.reproduce.export.card import Player, card
from experiments.reproduce.results.output import Row
from experiments.reproduce.results.runs import HeldOutRoom, Run
from experiments.reproduce.targets import building, optimality
from experiments.reproduce.targets.fig3 import FEDERATED
from experiments.reproduce.targets.plan import TARGETS
from storage.atomic import write_atomically
from training.run_folder import RunFolder

WEIGHTS = {
    **{f"k{robots}": ("fig3", FEDERATED.format(robots)) for robots in (2, 3, 4)},
    **{
        f"k{robots}-best": ("optimality", optimality.named(optimality.BEST, robots))
        for robots in optimality.ROBOTS
    },
    f"building-{building.COUNTS[-1]}": ("building", building.ROOMS.format(building.COUNTS[-1])),
}
"""Folders of weights, and the targets and their cells whose first seed they are of."""

SHARED = "planned.csv"
"""Several targets add to one file, so only the last manifest knows all of it."""

KEPT = (
    *("seed", "robots", "strategy", "scheme", "versions", "fingerprint", "digest"),
    *("ticks", "episodes", "converged", "evaluation"),
)
"""Of a summary."""

Manifest = Mapping[str, Any]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    given = _parser().parse_args(arguments)
    try:
        others = dict(_named(item) for item in given.weights)
        files = export(given.source, given.results, others)
    except (ConfigError, OSError) as error:
        print(f"export: {in_words(error)}", file=sys.stderr)
        return 2
    size = sum(path.stat().st_size for path in files)
    print(f"{len(files)} files, {size / 1e6:.1f} MB, in {given.results}")
    return 0


def export(source: Path, results: Path, others: Mapping[str, Path]) -> list[Path]:
    """Copies what is kept of a reproduction; returns the files written.

    Args:
        source: the folder of ``risfleet reproduce``.
        results: where to; made if it is missing.
        others: further runs whose weights are kept, by name.

    Raises:
        ConfigError: there is nothing to copy, or a file is not the one that its manifest says.
    """
    manifests = _manifests(source)
    results.mkdir(parents=True, exist_ok=True)
    files = [path for each in manifests.values() for path in _copied(each, source, results)]
    own = {name: each for name, each in manifests.items() if name != "claims"}  # figures' cells
    rows = [row for name, each in own.items() for row in _first_episodes(name, each, source)]
    files.append(repeat.write(results, rows))
    players = _players(manifests, source, others)
    for player in players:
        files += _weights(player.run, results / "weights" / player.name)
    if players:
        write_atomically(results / "weights" / hub.CARD, card(players))
        files += hub.dress(results / "weights")
    return list(dict.fromkeys(files))


def _manifests(source: Path) -> dict[str, Manifest]:
    """The manifest of each target that is there."""
    found = {}
    for name in TARGETS:
        path = source / f"{name}.manifest.json"
        if path.is_file():
            found[name] = json.loads(path.read_text(encoding="utf-8-sig"))
    if not found:
        raise ConfigError(f"{source}: no manifest of a target is there.")
    return found


def _copied(manifest: Manifest, source: Path, results: Path) -> list[Path]:
    """A target's files and its manifest."""
    digests = {}
    for name, digest in manifest["files"].items():
        content = (source / name).read_bytes()
        digests[name] = hashlib.sha256(content).hexdigest()
        if name != SHARED and digests[name] != digest:
            raise ConfigError(f"{source / name}: it was changed after its manifest was written.")
        (results / name).write_bytes(content)
    named = f"{manifest['target']}.manifest.json"
    write_atomically(results / named, json.dumps({**manifest, "files": digests}, indent=2) + "\n")
    return [results / name for name in (*digests, named)]


def _first_episodes(target: str, manifest: Manifest, source: Path) -> list[Row]:
    """Those of the cell that is trained fastest in Fig. 3 and of buildings, elsewhere of the last.

    The last one is that which changes the most.
    """
    names = list(manifest["cells"])
    name = names[0] if target in ("fig3", "building") else names[-1]
    cell = manifest["cells"][name]
    run = Run(source / next(iter(cell["seeds"].values()))["folder"])
    return repeat.rows_of(target, name, cell["overrides"], run)


def _players(
    manifests: Mapping[str, Manifest], source: Path, others: Mapping[str, Path]
) -> list[Player]:
    """The runs whose weights are kept, each with the runs of the other seeds of its cell."""
    players = []
    for name, (target, cell) in WEIGHTS.items():
        cells = manifests.get(target, {"cells": {}})["cells"]
        if cell in cells and name not in others:
            seeds = cells[cell]["seeds"].values()
            runs = [Run(source / seed["folder"]) for seed in seeds]
            if has_rooms(runs[0].config):
                runs = [HeldOutRoom.first(run) for run in runs]
            players.append(Player(name, cells[cell]["overrides"], runs))
    return players + [Player(name, (), [Run(folder)]) for name, folder in others.items()]


def _weights(run: Run, folder: Path) -> list[Path]:
    """What ``risfleet evaluate`` needs of a run, and what the run came to."""
    folder.mkdir(parents=True, exist_ok=True)
    kept = RunFolder(folder)
    nowhere = dataclasses.replace(run.config, run=RunConfig())
    runtime = dataclasses.replace(nowhere.runtime, connection=None)
    summary = {key: run.summary[key] for key in KEPT}
    kept.write_config(dataclasses.replace(nowhere, runtime=runtime))
    kept.write_summary(summary)
    shutil.copyfile(run.files.weights_file, kept.weights_file)
    return sorted(folder.iterdir())


def _named(item: str) -> tuple[str, Path]:
    """What ``--weights NAME=RUN`` says; a ConfigError if it says something else."""
    name, separator, folder = item.partition("=")
    if not separator or not name.replace("-", "").isalnum():
        raise ConfigError(f"--weights {item}: allowed is NAME=RUN, a name and a run's folder.")
    return name, user_path(folder)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("experiments.reproduce.export", description=__doc__)
    parser.add_argument(
        "source", type=user_path, metavar="DIR", help="what risfleet reproduce wrote"
    )
    parser.add_argument(
        "results", type=user_path, metavar="RESULTS", help="where to, such as results"
    )
    parser.add_argument(
        "--weights",
        action="append",
        default=[],
        metavar="NAME=RUN",
        help="keep the weights of this run, too; may be given again",
    )
    return parser
