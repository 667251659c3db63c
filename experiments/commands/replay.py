"""``risfleet replay``: an episode of a run as a page that plays anywhere, or as a film."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from conf import ConfigError
from conf.user_paths import user_path
from experiments.console.arguments import check_place, not_negative, share
from experiments.viewer import replays
from experiments.viewer.page import page
from storage.atomic import write_atomically
from training.run_folder import RunFolder

PAGE, FILMS = ".html", (".gif", ".mp4")


def main(arguments: Sequence[str]) -> int:
    """Runs the command; returns the exit status."""
    given = _parser().parse_args(arguments)
    try:
        _check(given.out)
        panels = _panels(given)
        if given.out.suffix == PAGE:
            write_atomically(given.out, page(f"RISFleet: {given.run}", {"panels": panels}))
        else:
            from experiments.viewer.film import save_film  # matplotlib: where it is wanted

            save_film(panels, given.out, frames_per_slot=given.frames)
    except ConfigError as error:
        print(f"risfleet: {error}", file=sys.stderr)
        return 2
    size = given.out.stat().st_size
    console = Console()
    console.print(f"{given.out}: {size / 1000:.0f} kB", highlight=False, soft_wrap=True)
    return 0


def _check(out: Path) -> None:
    if out.suffix not in (PAGE, *FILMS):
        allowed = ", ".join((PAGE, *FILMS))
        raise ConfigError(f"--out {out}: allowed is a file that ends in one of {allowed}.")
    check_place("--out", out)


def _panels(given: argparse.Namespace) -> list[replays.Panel]:
    """The run's episode, and what it stands against."""
    run = RunFolder(user_path(given.run))
    panels = [replays.of_run(run, given.episode, given.epsilon)]
    for other in given.against:
        if other in replays.RIVALS:
            panels.append(replays.rival(run, given.episode, other))
        else:
            there = RunFolder(user_path(other))
            panels.append(replays.of_run(there, given.episode, given.epsilon))
    return panels


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("risfleet replay", description=__doc__)
    parser.add_argument("run", metavar="RUN", help="the folder of a run, or of a building's room")
    parser.add_argument(
        "--out", type=user_path, required=True, metavar="FILE", help="a page, or a film: .gif, .mp4"
    )
    parser.add_argument(
        "--against",
        action="append",
        default=[],
        metavar="WHAT",
        help="beside it: another run's folder, oracle, or shortest; may be given again",
    )
    parser.add_argument(
        "--episode", type=not_negative, default=0, metavar="N", help="held-out start, from 0"
    )
    parser.add_argument("--epsilon", type=share, default=0.0, help="exploration; 0 is greedy")
    parser.add_argument(
        "--frames", type=_few, default=2, metavar="N", help="of a film, for each slot: 1 to 10"
    )
    return parser


def _few(text: str) -> int:
    """An option's number of frames."""
    if not text.isdecimal() or not 1 <= int(text) <= 10:
        raise argparse.ArgumentTypeError(f"{text}: allowed is a whole number from 1 to 10")
    return int(text)
