"""A building on the command line: evaluated as it is and personalised, told of, and refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conf.rooms import from_json
from experiments.analysis.rooms import adapted, of_room
from experiments.cli import main
from training.evaluation import Evaluator
from training.run_folder import RunFolder


@pytest.fixture(scope="module")
def columns(building_run: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What ``risfleet evaluate --personalise`` writes of the tiny building."""
    out: Path = tmp_path_factory.mktemp("evaluated") / "out.json"
    what = ["evaluate", str(building_run), "--episodes", "3", "--personalise", "20"]
    assert main([*what, "--json", str(out)]) == 0
    found: dict[str, Any] = json.loads(out.read_text())
    return found


def test_columns_are_means_over_rooms_of_each_kind(
    building_run: Path, columns: dict[str, Any]
) -> None:
    assert list(columns) == [
        f"{kind}{end}" for kind in ("trained in", "held out") for end in ("", ", personalised")
    ]
    folder = RunFolder(building_run)
    for kind, held_out in (("trained in", False), ("held out", True)):
        ees = []
        for room in from_json(folder.rooms_file.read_text()):
            if room.held_out == held_out:
                place = folder.room(room.name)
                config = place.read_config()
                evaluator = Evaluator(config, episodes=3)
                (measures,) = evaluator.play(*place.read_weights(config), (0.0,))
                ees.append(measures.summary()["ee"])
        assert columns[kind]["ee"] == pytest.approx(np.mean(ees))


def test_a_room_that_is_personalised_learns_on_by_itself(building_run: Path) -> None:
    folder = RunFolder(building_run)
    room = from_json(folder.rooms_file.read_text())[-1]
    place = folder.room(room.name)
    config = place.read_config()
    robots, ap = place.read_networks(config)
    model, own_ap = adapted(config, robots[0], ap, 20)
    assert not np.array_equal(model, robots[0, 0])
    assert not np.array_equal(own_ap, ap[0])
    assert np.array_equal(adapted(config, robots[0], ap, 20)[0], model)
    assert not np.array_equal(adapted(config, robots[0], ap, 40)[0], model)
    found, policies = of_room(place, 20)
    assert found == config
    for policy, weights in zip(policies, ((robots[0, 0], ap[0]), (model, own_ap)), strict=True):
        assert np.array_equal(policy[0], weights[0])
        assert np.array_equal(policy[1], weights[1])


def test_one_of_its_rooms_is_evaluated_like_any_run(
    building_run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("0000", "held-out-0000"):
        assert main(["evaluate", str(building_run / "rooms" / name), "--episodes", "2"]) == 0
        assert "2 held-out" in capsys.readouterr().out


def test_status_tells_of_rooms(building_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", str(building_run)]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    count = len(list((building_run / "rooms").glob("0*")))
    assert ["rooms", *f"{count} of {count} took part in the last round".split()] in lines


def test_one_room_cannot_be_personalised(
    tiny_run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", str(tiny_run), "--personalise", "20"]) == 2
    say = "risfleet: --personalise is for the run of a building: allowed is none here.\n"
    assert capsys.readouterr().err == say
