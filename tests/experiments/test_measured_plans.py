"""``risfleet oracle --measured``: plans on measured maps beside the oracles."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conf import compose
from env.oracles.gathering import gather, joined
from env.radio.measured_map import REPORT_BYTES
from experiments.analysis import measured_map, optimality_gap
from experiments.cli import main
from training.evaluation import Evaluator

SMALL = ("env.robots=2", "env.room.cell_m=2.0")


def test_plans_on_more_measurements_come_closer_to_the_oracle() -> None:
    evaluator = Evaluator(compose(SMALL), episodes=6)
    found, figures = measured_map.measures(evaluator, 0, (1, 300), 0.0, 2)
    best = optimality_gap.trajectory_measures(evaluator, 2).ee.mean()
    assert found[1].ee.mean() < found[300].ee.mean()
    assert found[300].ee.mean() == pytest.approx(best, rel=0.02)
    assert all((measures.success == 1).all() for measures in found.values())
    assert figures[1]["cells_seen"] < figures[300]["cells_seen"] <= 1


def test_bytes_are_eight_for_each_report() -> None:
    evaluator = Evaluator(compose(SMALL), episodes=2)
    _, figures = measured_map.measures(evaluator, 4, (2,), 0.0, 0)
    reports = joined(gather(evaluator.world, 4, 2))
    assert np.dtype(np.int32).itemsize + np.dtype(np.float32).itemsize == REPORT_BYTES
    assert figures[2]["bytes_up"] == 8 * len(reports.cell)
    assert figures[2]["cells_seen"] == len(set(reports.cell)) / len(evaluator.world.next_cell)


def told(tmp_path: Path, *options: str) -> dict[str, Any]:
    out = tmp_path / "oracle.json"
    common = ["--episodes", "2", "--slack", "0", "--json", str(out)]
    assert main(["oracle", *SMALL, *common, *options]) == 0
    return dict(json.loads(out.read_text()))


def test_the_command_adds_rows_and_changes_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = told(tmp_path)
    capsys.readouterr()
    found = told(tmp_path, "--measured", "5", "1", "5")
    printed = " ".join(capsys.readouterr().out.split())
    for word in ("measured, 1 episode", "cells seen", "bytes up", "nothing learns from rewards"):
        assert word in printed
    names = ["measured, 1 episode", "measured, 5 episodes"]
    assert list(found["measured"]) == names
    assert found["measures"].keys() == plain["measures"].keys() | {*names}
    assert plain["measures"] == {name: found["measures"][name] for name in plain["measures"]}
    assert "measured" not in plain
    best = found["measures"]["trajectory"]["ee"]
    for name in names:
        share = found["measures"][name]["ee"] / best
        assert found["measured"][name]["share"] == pytest.approx(share)
    noisy = told(tmp_path, "--measured", "1", "5", "--noise-db", "3")
    for name in names:
        assert noisy["measured"][name]["bytes_up"] == found["measured"][name]["bytes_up"]
    assert noisy["measures"][names[1]] != found["measures"][names[1]]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["env.ris.subsurfaces=2", "--measured", "1"], "env.ris.subsurfaces=2: allowed is 1"),
        (["env.ris.bits=1", "--measured", "1"], "env.ris.bits=1: allowed is at least 2"),
        (["env.channel.fading=slot", "--measured", "1"], "env.channel.fading=slot: allowed is"),
        (["--noise-db", "1"], "--noise-db 1: allowed is 0 without --measured"),
    ],
)
def test_mistakes_cost_one_sentence(
    arguments: list[str], said: str, refused: Callable[..., str]
) -> None:
    assert said in refused("oracle", *arguments)


@pytest.mark.parametrize(
    "options", [["--measured", "0"], ["--measured", "1", "--noise-db", "-1"], ["--measured"]]
)
def test_numbers_that_cannot_be_are_usage_errors(
    options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["oracle", *options])
    assert ended.value.code == 2
    assert options[-2 if len(options) > 1 else -1] in capsys.readouterr().err
