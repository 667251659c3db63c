"""A real deployment on two hosts: how its outages are judged, and that nothing of it stays."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from experiments.cli import main as risfleet
from tools.chaos import __main__ as suite
from tools.chaos import fleet as fleets
from tools.chaos import outages, report
from tools.chaos.fleet import CONNECTION, ChaosFleet, Node
from tools.chaos.hosts import TwoHosts, obstacle
from tools.chaos.outages import OUTAGES, Ending, Outage

NO_ROOT = "network namespaces need root"
JOINED = "[run 0 round 1 robot 2] joining 10.77.0.1:8001 with TLS"

# --- Where no hosts can be made -------------------------------------------------------------------


def test_the_two_hosts_alone_are_refused_with_the_reason(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(suite, "obstacle", lambda: NO_ROOT)
    monkeypatch.setattr(sys, "argv", ["chaos", "--hosts"])
    assert suite.main() == 2
    assert capsys.readouterr().err == f"chaos: --hosts cannot be played: {NO_ROOT}\n"


def test_the_whole_suite_leaves_the_two_hosts_out_and_reports_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(suite, "obstacle", lambda: NO_ROOT)
    monkeypatch.setattr(suite, "play_reference", lambda scratch: scratch)
    monkeypatch.setattr(sys, "argv", ["chaos", "--kills", "0", "--out", str(tmp_path)])
    assert suite.main() == 0
    content = json.loads((tmp_path / report.JSON_NAME).read_text())
    assert content["skipped"] == [f"two hosts skipped: {NO_ROOT}"]


# --- Verdicts -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, tiny_overrides: tuple[str, ...]) -> Path:
    """A run's folder, not to be changed."""
    folder: Path = tmp_path_factory.mktemp("hosts") / "run"
    given = ["state.every=1", "train.max_ticks=20", f"run.dir={folder}"]
    assert risfleet(["train", *tiny_overrides, *given]) == 0
    return folder


@pytest.fixture
def ended(tmp_path: Path, run: Path) -> tuple[Any, Path]:
    """A fleet of one node, as far as a verdict looks at it, and a run that has ended there."""
    folder = shutil.copytree(run, tmp_path / "run")
    node = SimpleNamespace(folder=tmp_path / "node-0")
    states = [folder / "state" / "robot-00"]
    return SimpleNamespace(nodes=[node], states=states, said=lambda place: JOINED), folder


def lose_a_robot(folder: Path) -> None:
    content = json.loads((folder / "summary.json").read_text())
    content["losses"] = [{"loss": "robot 2", "back_to": 3, "waited_s": 1.0}]
    (folder / "summary.json").write_text(json.dumps(content))


def test_a_run_is_held_to_the_robots_that_it_may_lose(ended: tuple[Any, Path]) -> None:
    fleet, folder = ended
    harmless, harmful = Outage("harmless"), Outage("harmful", loses=True)
    assert outages.faults(harmless, fleet, folder, folder) == []
    assert outages.faults(harmful, fleet, folder, folder) == ["robots lost: none"]
    lose_a_robot(folder)
    assert outages.faults(harmful, fleet, folder, folder) == []
    assert len(outages.faults(harmless, fleet, folder, folder)) == 1


def test_a_robot_without_tls_or_without_a_state_of_its_own_is_a_fault(
    ended: tuple[Any, Path], tmp_path: Path
) -> None:
    fleet, folder = ended
    fleet.said = lambda place: JOINED.replace("with TLS", "without TLS")
    fleet.states = [tmp_path / "nowhere"]
    found = outages.faults(Outage("none"), fleet, folder, folder)
    assert found == [
        f"no state of a robot in {tmp_path / 'nowhere'}",
        "node-0 did not join with TLS",
    ]


def test_every_outage_is_in_the_report_with_what_was_wrong(tmp_path: Path) -> None:
    bad = Ending("relay", 99.0, 50.2, [{"back_to": 20, "waited_s": 58.9}], [1, 4], ["it hung"])
    played = [(outage, replace(bad)) for outage in OUTAGES]
    shown = outages.table(played)
    assert shown.row_count == len(OUTAGES)
    assert list(shown.columns[-1].cells) == ["it hung"] * len(OUTAGES)
    assert list(shown.columns[-3].cells) == ["awaited 59 s"] * len(OUTAGES)
    outages.write(tmp_path, played)
    content = json.loads((tmp_path / outages.JSON_NAME).read_text())
    assert [item["outage"]["name"] for item in content] == [outage.name for outage in OUTAGES]
    assert content[0]["ending"]["starts"] == [1, 4]


# --- The fleet ------------------------------------------------------------------------------------


def test_a_supernode_that_ended_is_started_again_after_a_while(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    codes: list[int | None] = [None, 9, 9, 9, None]
    dead = SimpleNamespace(poll=lambda: codes.pop(0))
    fleet = ChaosFleet(SimpleNamespace(), tmp_path)
    node = Node(tmp_path / "node-0", dead)
    fleet.nodes = [node]
    now_s = iter([10.0, 10.0 + fleets.RESTART_S, 11.0 + fleets.RESTART_S])
    monkeypatch.setattr(fleets, "time", SimpleNamespace(monotonic=lambda: next(now_s)))
    monkeypatch.setattr(fleet, "_start_node", lambda folder: dead)
    starts = []
    for _ in range(5):
        fleet.tend()
        starts.append(node.starts)
    assert starts == [1, 1, 1, 2, 2]


@pytest.mark.chaos
@pytest.mark.flower
def test_nothing_of_a_fleet_is_left_whatever_happens(tmp_path: Path) -> None:
    if why_not := obstacle():
        pytest.skip(why_not)
    hosts = TwoHosts()
    with pytest.raises(RuntimeError), hosts, ChaosFleet(hosts, tmp_path) as fleet:  # noqa: PT012
        crowd = fleet.crowd
        assert {"SuperLink", "SuperNode"} <= set(crowd.roles())
        raise RuntimeError
    assert crowd.alive() == set()
    listed = subprocess.run(["ip", "netns"], capture_output=True, text=True, check=True).stdout
    assert not any(name in listed for name in hosts.names)
    config = (tmp_path / "hub" / "flower" / "config.toml").read_text()
    assert f"[superlink.{CONNECTION}]" in config
