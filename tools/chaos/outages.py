"""What delay, loss, a cut cable and a killed SuperNode do to a real deployment on two hosts."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from rich.table import Table

from tools.chaos.fleet import ChaosFleet, FleetError
from tools.chaos.hosts import ADDRESSES, TwoHosts
from tools.chaos.kill_points import Watched, read_json
from tools.chaos.tasks import DEPLOYMENT, ROBOTS
from tools.chaos.verdict import damaged, differences

JSON_NAME = "hosts.json"
PATIENCE_S = 420.0
"""The longest that the command may train; on a busy machine it takes half of it."""
STRIKE = 30
"""The window whose checkpoint is awaited before something is cut or killed; a round has 20."""

_LOOK_S = 0.05


@dataclass(frozen=True)
class Outage:
    """What a run on two hosts is to bear.

    Attributes:
        name: of it.
        delay_ms: of the cable, one way.
        loss_percent: of the packets, each way.
        cut_s: how long the cable is cut.
        kills: whether a SuperNode is killed, and started again as systemd does.
        loses: whether robots are lost by it, so that all go back to a checkpoint.
    """

    name: str
    delay_ms: float = 1.0
    loss_percent: float = 0.0
    cut_s: float = 0.0
    kills: bool = False
    loses: bool = False


OUTAGES = (
    Outage("a long, bad cable", delay_ms=5.0, loss_percent=1.0),
    Outage("cable cut for 5 s", cut_s=5.0),
    Outage("cable cut for 45 s", cut_s=45.0, loses=True),
    Outage("a SuperNode killed", kills=True, loses=True),
)


@dataclass
class Ending:
    """How a run on two hosts ended.

    Attributes:
        kind: of the cable, see `TwoHosts`.
        seconds: from the command's start to its end.
        further_s: from the cut of the cable until the server had a later checkpoint; 0 without.
        losses: what the run's summary says of them.
        starts: how often each SuperNode was started.
        reasons: what was not as promised, a sentence each.
    """

    kind: str = ""
    seconds: float = 0.0
    further_s: float = 0.0
    losses: list[dict[str, Any]] = field(default_factory=list)
    starts: list[int] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)


def play(outage: Outage, reference: Path, scratch: Path) -> Ending:
    """Plays a run through an outage, and removes the hosts.

    Args:
        outage: what it is to bear.
        reference: folder of the run in one process that nobody disturbed.
        scratch: a folder to make, with a short path; it keeps the run's files and all logs.
    """
    scratch.mkdir()
    ending = Ending()
    folder = scratch / "hub" / "run"
    try:
        with (
            TwoHosts(outage.delay_ms, outage.loss_percent) as hosts,
            ChaosFleet(hosts, scratch) as fleet,
        ):
            ending.kind = hosts.kind
            _train(outage, hosts, fleet, folder, ending)
            ending.starts = [node.starts for node in fleet.nodes]
            if left := fleet.stop():
                ending.reasons.append(f"left behind: {', '.join(left)}")
            if not ending.reasons:
                ending.reasons += faults(outage, fleet, folder, reference)
            ending.losses = read_json(folder / "summary.json").get("losses", [])
    except (FleetError, OSError) as error:
        ending.reasons.append(str(error))
    return ending


def _train(
    outage: Outage, hosts: TwoHosts, fleet: ChaosFleet, folder: Path, ending: Ending
) -> None:
    """Trains from the beginning to the end, with the outage in the middle."""
    began = time.monotonic()
    run = fleet.train(DEPLOYMENT.begin(folder))
    watched = Watched(folder, ROBOTS, time.time())

    def wait(condition: Callable[[], bool]) -> bool:
        """Waits until a condition holds; False if the command ended before, or time is up."""
        while not condition():
            if run.poll() is not None or time.monotonic() - began > PATIENCE_S:
                return False
            fleet.tend()
            time.sleep(_LOOK_S)
        return True

    if wait(lambda: watched.checkpoint() >= STRIKE):
        struck, window = time.monotonic(), watched.checkpoint()
        if outage.cut_s:
            hosts.cut()
            wait(lambda: time.monotonic() - struck >= outage.cut_s)
            hosts.mend()
        if outage.kills:
            fleet.nodes[-1].process.kill()
        if outage.cut_s and wait(lambda: watched.checkpoint() > window):
            ending.further_s = round(time.monotonic() - struck, 1)
        wait(lambda: False)
    else:
        ending.reasons.append(f"not at window {STRIKE} after {time.monotonic() - began:.0f} s")
    ending.seconds = round(time.monotonic() - began, 1)
    _judge(run, fleet, ending)


def _judge(run: subprocess.Popen[str], fleet: ChaosFleet, ending: Ending) -> None:
    """Says why the command did not succeed, if it did not."""
    lines = fleet.said("hub/train").splitlines()[-20:]
    said = "\n".join(dict.fromkeys(lines))  # a display says its line again and again
    if run.poll() is None:
        ending.reasons.append(f"it hung: {said!r}")
    elif run.returncode != 0:
        ending.reasons.append(f"status {run.returncode}: {said!r}")


def faults(outage: Outage, fleet: ChaosFleet, folder: Path, reference: Path) -> list[str]:
    """What a finished run has otherwise than promised, a sentence each."""
    found = differences(folder, reference)
    for state in fleet.states:
        checkpoints = list(state.glob("**/checkpoint-*.safetensors"))
        found += damaged(state) if checkpoints else [f"no state of a robot in {state}"]
    for node in fleet.nodes:
        said = fleet.said(f"{node.folder.name}/supernode")
        if f"joining {ADDRESSES[0]}:" not in said or "without TLS" in said:
            found.append(f"{node.folder.name} did not join with TLS")
    losses = read_json(folder / "summary.json")["losses"]
    if bool(losses) != outage.loses:
        found.append(f"robots lost: {losses or 'none'}")
    return found


def write(folder: Path, played: Sequence[tuple[Outage, Ending]]) -> None:
    """Writes every outage and how its run ended, as JSON."""
    folder.mkdir(parents=True, exist_ok=True)
    content = [{"outage": asdict(outage), "ending": asdict(ending)} for outage, ending in played]
    (folder / JSON_NAME).write_text(json.dumps(content, indent=2) + "\n")


def table(played: Sequence[tuple[Outage, Ending]]) -> Table:
    """What each run had to bear, and how it ended."""
    shown = Table(title="A deployment on two hosts")
    columns = ("outage", "delay one way", "loss", "further after", "robots lost", "run", "ended")
    for name in columns:
        shown.add_column(name)
    for outage, ending in played:
        cable = (f"{outage.delay_ms:g} ms", f"{outage.loss_percent:g} %")
        back = f"{ending.further_s:.0f} s" if ending.further_s else ""
        words = "; ".join(ending.reasons) or "the same bits"
        waits = [f"awaited {loss['waited_s']:.0f} s" for loss in ending.losses]
        shown.add_row(outage.name, *cable, back, ", ".join(waits), f"{ending.seconds:.0f} s", words)
    return shown
