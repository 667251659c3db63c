"""``make chaos``: many kills over all runtimes, bounded in number and time."""

from __future__ import annotations

import argparse
import random
import shutil
import signal
import sys
import tempfile
from pathlib import Path

from rich.console import Console

from chaos import links, report
from chaos.attempt import Attempt
from chaos.crowd import Deck
from chaos.hosts import obstacle
from chaos.story import Row, Story
from chaos.tasks import ALL, LOCAL, Runtime

MOST_A_RUN = {"local": 4, "simulation": 2, "deployment": 3}
RUNS_A_KILL = 2
SHARES = {"local": 4, "simulation": 3, "deployment": 3}


def main() -> int:
    """Runs the command; 0 if every kill was survived."""
    parser = argparse.ArgumentParser(prog="chaos", description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--runtimes", default=",".join(ALL))
    parser.add_argument("--out", type=Path, default=Path("runs/chaos"))
    parser.add_argument("--no-links", action="store_true", help="leave the two hosts out")
    asked = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that all is cleaned up then, too
    console = Console()
    chosen = [ALL[name] for name in asked.runtimes.split(",")]
    skipped = [f"{item.name} skipped: {item.missing()}" for item in chosen if item.missing()]
    for line in skipped:
        console.print(line, highlight=False)
    playable = [item for item in chosen if not item.missing()]
    if not asked.no_links:
        _try_links(asked.out, console)
    rows: list[Row] = []
    scratch = Path(tempfile.mkdtemp(prefix="rc-", dir="/tmp"))  # Ray's sockets need short paths
    try:
        _play_all(playable, asked.kills, asked.seed, scratch, rows, console)
    except KeyboardInterrupt:
        console.print("Stopped by Ctrl-C.")
    finally:
        report.write(asked.out, rows, asked.seed, skipped)
        console.print(report.table(rows))
        console.print(f"{asked.out / report.CSV_NAME} holds a row for each.", highlight=False)
        for number in {row.run for row in rows if not row.survived}:
            kept = asked.out / f"failed-{asked.seed}-{number}"
            shutil.move(scratch / str(number), kept)
            console.print(f"what run {number} left is in {kept}", highlight=False)
        shutil.rmtree(scratch, ignore_errors=True)
    return 0 if len(rows) >= asked.kills and all(row.survived for row in rows) else 1


def _try_links(out: Path, console: Console) -> None:
    """What delay, loss and a cut cable do, as a table and in ``links.json``."""
    if why := obstacle():
        console.print(f"two hosts skipped: {why}", highlight=False)
        return
    heard = [(trial, links.converse(trial)) for trial in (*links.DELAYS, *links.CUTS)]
    console.print(links.table(heard))
    links.write(out / "links.json", heard)


def _play_all(
    runtimes: list[Runtime],
    kills: int,
    seed: int,
    scratch: Path,
    rows: list[Row],
    console: Console,
) -> None:
    """Plays runs in turn until each runtime has had its share of the kills."""
    rng = random.Random(seed)
    reference = play_reference(scratch / "r")
    decks = {runtime.name: Deck(runtime.roles, rng) for runtime in runtimes}
    number = 0
    for runtime, share in shares(runtimes, kills):
        done = 0
        while done < share and number < RUNS_A_KILL * kills:  # a run may end before its kill
            number += 1
            own = scratch / str(number)
            own.mkdir()
            planned = min(share - done, rng.randint(1, MOST_A_RUN[runtime.name]))
            story = Story(number, runtime, reference, own, planned, rng, decks[runtime.name])
            played = story.play(
                lambda row: console.print(_line(row), highlight=False, soft_wrap=True)
            )
            rows += played
            done += len(played)
            for reason in {row.reason for row in played if not row.survived}:
                console.print(f"run {number} NOT SURVIVED: {reason}", highlight=False)


def play_reference(scratch: Path, runtime: Runtime = LOCAL) -> Path:
    """The task undisturbed, by default in one process; returns the run's folder."""
    scratch.mkdir()
    folder = scratch / "run"
    with Attempt(runtime.begin(folder), folder, scratch, runtime) as attempt:
        outcome = attempt.finish()
    if outcome.status != 0:
        raise RuntimeError(f"the reference run failed: {outcome.errors}")
    return folder


def shares(runtimes: list[Runtime], kills: int) -> list[tuple[Runtime, int]]:
    """Kills of each runtime; together at least as many as asked."""
    whole = sum(SHARES[runtime.name] for runtime in runtimes)
    return [(runtime, -(-kills * SHARES[runtime.name] // whole)) for runtime in runtimes]


def _line(row: Row) -> str:
    when = f"{row.moment}, checkpoint {row.window}"
    torn = f"; half written: {row.unfinished}" if row.unfinished else ""
    what = f"{row.happened}, {row.seconds} s{torn}"
    return f"run {row.run} {row.runtime}: {row.role} ({when}): {what}"


if __name__ == "__main__":
    sys.exit(main())
