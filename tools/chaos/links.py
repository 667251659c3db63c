"""What delay, loss and a cut cable do to the lockstep link between two hosts."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from tools.chaos.hosts import ADDRESSES, TwoHosts

ENDS = str(Path(__file__).with_name("link_ends.py"))
PATIENT_S, IMPATIENT_S = 60.0, 2.0
CUT_S = 3.0


@dataclass(frozen=True)
class Trial:
    """A conversation over a cable.

    Attributes:
        delay_ms: one way; a tick takes a round trip, so twice this at least.
        loss_percent: of the packets, each way.
        ticks: of the conversation.
        cut_s: how long the cable is cut in the middle; None for good, 0 not at all.
        timeout_s: the longest silence that both ends bear.
    """

    delay_ms: float
    loss_percent: float = 0.0
    ticks: int = 400
    cut_s: float | None = 0.0
    timeout_s: float = PATIENT_S

    @property
    def bound_per_s(self) -> float:
        """Steps per second that the delay allows: one a round trip."""
        return 1e3 / (2 * self.delay_ms)


DELAYS = [Trial(delay, loss) for loss in (0.0, 1.0) for delay in (1.0, 5.0, 20.0)]
CUTS = [Trial(5.0, cut_s=CUT_S), Trial(5.0, cut_s=None, timeout_s=IMPATIENT_S)]


@dataclass(frozen=True)
class Heard:
    """What the ends of a link said at their ends.

    Attributes:
        kind: of the cable.
        server: `correct`, `round_trips`, `elapsed_s` and `longest_s`, or `error` and `message`.
        client: `error` and `message`, both empty where it ended well, and `bare_ms`, the median
            round trip of bare datagrams over the same cable.
    """

    kind: str
    server: dict[str, Any]
    client: dict[str, Any]


def converse(trial: Trial) -> Heard:
    """Plays a trial between two hosts, and removes them."""
    with TwoHosts(trial.delay_ms, trial.loss_percent) as hosts:
        python = [sys.executable, ENDS]
        limits = str(trial.ticks), str(trial.timeout_s)
        server = hosts.start(0, [*python, "server", ADDRESSES[0], *limits])
        port = str(_line(server)["port"])
        client = hosts.start(1, [*python, "client", ADDRESSES[0], port, str(trial.timeout_s)])
        _line(server)
        if trial.cut_s is None or trial.cut_s > 0:
            hosts.cut()
        if trial.cut_s:
            time.sleep(trial.cut_s)
            hosts.mend()
        return Heard(hosts.kind, _line(server), _line(client))


def _line(child: subprocess.Popen[str]) -> dict[str, Any]:
    """The next line that an end says; each has deadlines of its own, so it comes."""
    assert child.stdout is not None
    said: dict[str, Any] = json.loads(child.stdout.readline())
    return said


def write(path: Path, heard: list[tuple[Trial, Heard]]) -> None:
    """Writes every trial and what came of it, as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = [{"trial": asdict(trial), "heard": asdict(ends)} for trial, ends in heard]
    path.write_text(json.dumps(content, indent=2) + "\n")


def table(heard: list[tuple[Trial, Heard]]) -> Table:
    """Steps per second against the bounds, and what became of cut cables.

    The bounds are one step a round trip: of the delay that was asked for, and of bare datagrams.
    """
    kind = {"netem": "veth and tc netem", "relay": "TAP devices and a process between"}
    shown = Table(title=f"The link between two hosts: {kind[heard[0][1].kind]}")
    columns = ("delay one way", "loss", "cut", "steps/s", "1/RTT", "1/RTT measured")
    for name in (*columns, "longest wait", "ended"):
        shown.add_column(name)
    for trial, ends in heard:
        cut = "for good" if trial.cut_s is None else f"{trial.cut_s:g} s"
        rate = wait = ""
        words = f"{ends.server.get('error')}: {ends.server.get('message')}"
        if "error" not in ends.server:
            rate = f"{trial.ticks / ends.server['elapsed_s']:.1f}"
            wait = f"{ends.server['longest_s']:.2f} s"
            words = "correct" if ends.server["correct"] else "WRONG"
        place = (f"{trial.delay_ms:g} ms", f"{trial.loss_percent:g} %", cut)
        bounds = (f"{trial.bound_per_s:.0f}", f"{1e3 / ends.client['bare_ms']:.0f}")
        shown.add_row(*place, rate, *bounds, wait, words)
    return shown
