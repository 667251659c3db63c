"""``python -m repeatable``: digests of runs, and runs under a kill schedule."""

from __future__ import annotations

import argparse
import random
import signal
import sys
import tempfile
from functools import partial
from pathlib import Path

from repeatable import kills
from repeatable.checkpoints import newest_arrays
from repeatable.live import LiveError
from repeatable.process_tracker import ROLES, Deck
from repeatable.records import digest
from storage.checkpoint_files import CheckpointError


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 0 if all digests are the same, 2 if it could not be done."""
    asked = _parser().parse_args(arguments)
    try:
        return _show(asked.folder) if asked.verb == "digest" else _kill(asked)
    except (CheckpointError, LiveError, ValueError) as error:
        print(f"repeatable: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m repeatable", description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
    shown = verbs.add_parser("digest", help="what a run with this state-dir has come to")
    shown.add_argument("folder", type=Path)
    kill = verbs.add_parser("kill", help="play an app undisturbed and under kills, and compare")
    kill.add_argument("app", type=Path, help="the app's folder, with its pyproject.toml")
    kill.add_argument("--clients", type=partial(_count, 1), required=True)
    kill.add_argument(
        "--kills", type=partial(_count, 0), default=3, help="0: plays it twice undisturbed"
    )
    kill.add_argument("--seed", type=int, default=0, help="of the schedule")
    kill.add_argument("--run-config", default="", help="as flwr run takes it, without state-dir")
    kill.add_argument("--deployment", action="store_true", help="SuperNodes, and no simulation")
    kill.add_argument("--roles", default="", help="whom to kill, with commas between")
    return parser


def _count(least: int, text: str) -> int:
    if not text.isdecimal() or int(text) < least:
        raise argparse.ArgumentTypeError(f"{text}: allowed is a whole number of at least {least}")
    return int(text)


def _show(folder: Path) -> int:
    found = newest_arrays(folder)
    if found is None:
        raise ValueError(f"{folder} holds no run: allowed is the state-dir of one")
    print(f"round {found[0]}: {digest(found[1])}")
    return 0


def _kill(asked: argparse.Namespace) -> int:
    if not (asked.app / "pyproject.toml").is_file():
        raise ValueError(f"{asked.app} holds no pyproject.toml: allowed is the folder of an app")
    task = kills.Task(asked.app, asked.clients, asked.run_config, asked.deployment)
    usual = kills.DEPLOYMENT if asked.deployment else kills.SIMULATION
    roles = asked.roles.split(",") if asked.roles else usual
    if unknown := set(roles) - ROLES.keys():
        raise ValueError(f"--roles={','.join(sorted(unknown))}: allowed are {', '.join(ROLES)}")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that all is cleaned up then, too
    rng = random.Random(asked.seed)
    with tempfile.TemporaryDirectory(prefix="repeatable-") as scratch:
        first = kills.play(task, Path(scratch) / "undisturbed")
        each = f"{first.rounds} rounds of {first.round_s:.2g} s"
        print(f"undisturbed: {each}, {first.digest}", flush=True)
        due = kills.schedule(rng, asked.kills, first.rounds, first.round_s)
        deck = Deck(roles, rng)
        second = kills.play(task, Path(scratch) / "killed", due, deck, partial(print, flush=True))
    print(f"{second.killed} of {len(due)} kills: {second.rounds} rounds, {second.digest}")
    same = (first.rounds, first.digest) == (second.rounds, second.digest)
    print("the same bits" if same else "NOT the same bits")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
