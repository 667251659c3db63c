"""``risfleet replay``: an episode of a run as a page that plays anywhere, or as a film."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from rich.console import Console

from conf.user_paths import user_path
from experiments.console import PLAIN
from experiments.console.arguments import not_negative, positive, share
from experiments.viewer.replays import beside
from experiments.viewer.saving import check_out, save
from training.run_folder import RunFolder


def main(arguments: Sequence[str]) -> int:
    """Runs the command; returns the exit status."""
    given = _parser().parse_args(arguments)
    check_out(given.out)
    run = RunFolder.named(user_path(given.run))
    panels = beside(run, given.against, given.episode, given.epsilon)
    save(panels, f"RISFleet: {given.run}", given.out, given.frames)
    Console().print(f"{given.out}: {given.out.stat().st_size / 1000:.0f} kB", **PLAIN)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("risfleet replay", description=__doc__)
    parser.add_argument("run", metavar="RUN", help="the folder of a run, or of a building's room")
    say = "a page, or a film: .gif, .mp4"
    parser.add_argument("--out", type=user_path, required=True, metavar="FILE", help=say)
    say = "beside it: another run's folder, oracle, or shortest; may be given again"
    parser.add_argument("--against", action="append", default=[], metavar="WHAT", help=say)
    say = "held-out start, from 0"
    parser.add_argument("--episode", type=not_negative, default=0, metavar="N", help=say)
    parser.add_argument("--epsilon", type=share, default=0.0, help="exploration; 0 is greedy")
    say = "of a film, for each slot"
    parser.add_argument("--frames", type=positive, default=2, metavar="N", help=say)
    return parser
