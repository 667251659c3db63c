"""``make chaos``: many kills over all runtimes, bounded in number and time."""

from __future__ import annotations

import argparse
import random
import shutil
import signal
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from repeatable.process_tracker import Deck
from tools.chaos import links, outages, report
from tools.chaos.attempt import Attempt
from tools.chaos.hosts import obstacle
from tools.chaos.scenario import KillScenario, Row
from tools.chaos.tasks import ALL, LOCAL, Runtime

MOST_A_RUN = {"local": 4, "simulation": 2, "deployment": 3}
RUNS_A_KILL = 2
SHARES = {"local": 4, "simulation": 3, "deployment": 3}


def main() -> int:
    """Runs the command; 0 if every kill and every outage was survived, 2 if it is refused."""
    asked = _parser().parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that all is cleaned up then, too
    console = Console()
    why_no_hosts = "" if asked.no_links else obstacle()
    if asked.hosts and why_no_hosts:
        print(f"chaos: --hosts cannot be played: {why_no_hosts}", file=sys.stderr)
        return 2
    chosen = [] if asked.hosts else _chosen(asked.runtimes, asked.roles, asked.moments)
    skipped = [f"{item.name} skipped: {item.missing()}" for item in chosen if item.missing()]
    skipped += [f"two hosts skipped: {why_no_hosts}"] if why_no_hosts else []
    for line in skipped:
        console.print(line, highlight=False)
    playable = [item for item in chosen if not item.missing()]
    scratch = Path(tempfile.mkdtemp(prefix="rc-", dir="/tmp"))  # Ray's sockets need short paths
    try:
        reference = play_reference(scratch / "r")
        survived = True
        if not asked.no_links and not why_no_hosts:
            survived = _try_hosts(asked.out, reference, scratch, console)
        if not asked.hosts:
            survived &= _try_kills(playable, asked, reference, scratch, skipped, console)
    except KeyboardInterrupt:
        console.print("Stopped by Ctrl-C.")
        survived = False
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return 0 if survived else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="chaos", description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--runtimes", default=",".join(ALL))
    parser.add_argument("--roles", default="", help="whom to kill, such as watchdog,SuperExec")
    parser.add_argument("--moments", default="", help="when to kill, such as start-up")
    parser.add_argument("--out", type=Path, default=Path("runs/chaos"))
    parts = parser.add_mutually_exclusive_group()
    parts.add_argument("--hosts", action="store_true", help="the two hosts alone")
    parts.add_argument("--no-links", action="store_true", help="leave the two hosts out")
    return parser


def _chosen(runtimes: str, roles: str = "", moments: str = "") -> list[Runtime]:
    """The runtimes to play, those left out in which nobody is to be killed."""
    found = [replace(ALL[name], moments=_listed(moments)) for name in runtimes.split(",")]
    if roles:
        wanted = _listed(roles)
        found = [replace(r, roles=tuple(role for role in r.roles if role in wanted)) for r in found]
    return [runtime for runtime in found if runtime.roles]


def _listed(text: str) -> tuple[str, ...]:
    return tuple(filter(None, text.split(",")))


def _try_hosts(out: Path, reference: Path, scratch: Path, console: Console) -> bool:
    """Two hosts, with toy robots and with a deployment; whether that ended as it should."""
    heard = [(trial, links.converse(trial)) for trial in (*links.DELAYS, *links.CUTS)]
    console.print(links.table(heard))
    links.write(out / "links.json", heard)
    played: list[tuple[outages.Outage, outages.Ending]] = []
    for number, outage in enumerate(outages.OUTAGES, 1):
        own = scratch / f"hosts-{number}"
        ending = outages.play(outage, reference, own)
        played.append((outage, ending))
        words = "; ".join(ending.reasons) or f"the same bits after {ending.seconds} s"
        console.print(f"two hosts: {outage.name}: {words}", highlight=False, soft_wrap=True)
        if ending.reasons:
            _keep(own, out / f"failed-hosts-{number}", console)
        shutil.rmtree(own, ignore_errors=True)
        outages.write(out, played)
    console.print(outages.table(played))
    return not any(ending.reasons for _, ending in played)


def _try_kills(
    runtimes: list[Runtime],
    asked: argparse.Namespace,
    reference: Path,
    scratch: Path,
    skipped: list[str],
    console: Console,
) -> bool:
    """Kills processes, and reports on those that were killed before a Ctrl-C, too."""
    rows: list[Row] = []
    try:
        _play_all(runtimes, asked.kills, asked.seed, reference, scratch, rows, console)
    finally:
        report.write(asked.out, rows, asked.seed, skipped)
        console.print(report.table(rows))
        console.print(f"{asked.out / report.CSV_NAME} holds a row for each.", highlight=False)
        for number in {row.run for row in rows if not row.survived}:
            kept = asked.out / f"failed-{asked.seed}-{number}"
            _keep(scratch / str(number), kept, console)
    return len(rows) >= asked.kills and all(row.survived for row in rows)


def _keep(left: Path, kept: Path, console: Console) -> None:
    shutil.rmtree(kept, ignore_errors=True)  # of an earlier time
    shutil.move(left, kept)
    console.print(f"what it left is in {kept}", highlight=False)


def _play_all(
    runtimes: list[Runtime],
    kills: int,
    seed: int,
    reference: Path,
    scratch: Path,
    rows: list[Row],
    console: Console,
) -> None:
    """Plays runs in turn until each runtime has had its share of the kills."""
    rng = random.Random(seed)
    decks = {runtime.name: Deck(runtime.roles, rng) for runtime in runtimes}
    number = 0
    for runtime, share in shares(runtimes, kills):
        done = 0
        while done < share and number < RUNS_A_KILL * kills:  # a run may end before its kill
            number += 1
            own = scratch / str(number)
            own.mkdir()
            planned = min(share - done, rng.randint(1, MOST_A_RUN[runtime.name]))
            story = KillScenario(number, runtime, reference, own, planned, rng, decks[runtime.name])
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
