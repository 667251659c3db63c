"""A few kills of a run in one process; `make chaos` has many, over all runtimes."""

from __future__ import annotations

import csv
import json
import random
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from repeatable.process_tracker import Deck
from tools.chaos import report
from tools.chaos.__main__ import _chosen, play_reference, shares
from tools.chaos.kill_points import draw
from tools.chaos.scenario import KillScenario, Row
from tools.chaos.tasks import ALL, DEPLOYMENT, LOCAL, SIMULATION, Runtime

SHORT = replace(LOCAL, windows=40)
KILLS = 3


@pytest.fixture
def scratch() -> Iterator[Path]:
    """A folder with a path that is short enough for Ray."""
    with tempfile.TemporaryDirectory(prefix="rc-", dir="/tmp") as folder:
        yield Path(folder)


def survive(runtime: Runtime, reference: Path, scratch: Path, kills: int, seed: int) -> list[Row]:
    """Plays a run with some kills; fails where one was not survived."""
    rng = random.Random(seed)
    own = scratch / "1"
    own.mkdir()
    rows = KillScenario(1, runtime, reference, own, kills, rng, Deck(runtime.roles, rng)).play()
    assert [row.reason for row in rows if not row.survived] == []
    return rows


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc")
def test_a_run_in_one_process_survives_kills_at_random_moments(scratch: Path) -> None:
    rows = survive(SHORT, play_reference(scratch / "r", SHORT), scratch, KILLS, seed=5)
    assert len(rows) == KILLS
    assert {row.role for row in rows} == {"launcher"}


@pytest.mark.chaos
@pytest.mark.flower
@pytest.mark.parametrize("name", ["simulation", "deployment"])
def test_a_run_on_flower_survives_a_kill_of_a_random_process(scratch: Path, name: str) -> None:
    if missing := ALL[name].missing():
        pytest.skip(missing)
    reference = play_reference(scratch / "r")
    assert len(survive(ALL[name], reference, scratch, 1, seed=2)) == 1


# --- The plan -------------------------------------------------------------------------------------


def test_the_kills_are_shared_among_the_runtimes_and_none_is_left_out() -> None:
    assert [share for _, share in shares([LOCAL, SIMULATION, DEPLOYMENT], 50)] == [20, 15, 15]
    assert sum(share for _, share in shares([LOCAL, SIMULATION], 50)) >= 50


def test_a_runtime_or_a_key_that_is_no_choice_is_named() -> None:
    assert LOCAL.missing() == ""
    assert replace(LOCAL, name="moon").missing() == "runtime=moon is no choice in this version"
    changed = replace(LOCAL, overrides=("federation.on_moon=wait",))
    assert changed.missing() == "federation.on_moon is no key in this version"


def test_a_play_may_be_for_some_roles_and_moments_alone() -> None:
    assert _chosen("local,simulation") == [LOCAL, SIMULATION]
    found = _chosen("local,simulation,deployment", "watchdog,SuperNode")
    roles = [(runtime.name, runtime.roles) for runtime in found]
    assert roles == [("simulation", ("watchdog",)), ("deployment", ("watchdog", "SuperNode"))]
    (early,) = _chosen("deployment", moments="start-up")
    rng = random.Random(0)
    assert {draw(rng, early, 0).kind for _ in range(50)} == {"start-up"}


def test_the_report_counts_by_runtime_and_role(tmp_path: Path) -> None:
    good = Row(1, "local", "launcher", "start-up", 0, "all ended with it", 0.1)
    bad = replace(good, survived=False, reason="it hung")
    rows = [good, bad, replace(good, runtime="simulation", role="raylet")]
    expected = {("local", "launcher"): (1, 2), ("simulation", "raylet"): (1, 1)}
    assert report.counts(rows) == expected
    report.write(tmp_path, rows, 7, ["deployment skipped: no choice"])
    content = json.loads((tmp_path / report.JSON_NAME).read_text())
    assert (content["survived"], content["tried"], content["seed"]) == (2, 3, 7)
    with (tmp_path / report.CSV_NAME).open() as file:
        assert [row["reason"] for row in csv.DictReader(file)] == ["", "it hung", ""]
