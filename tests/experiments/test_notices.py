"""What a run says before it starts."""

from __future__ import annotations

from pathlib import Path

import pytest

from conf import ConfigError, compose
from experiments.cli import main
from experiments.console.notices import notices

SHORT = ("runtime=local", "train.max_ticks=20", "federation.every=10", "evaluation.episodes=2")
QUIET = ("run.figures=false", "run.tensorboard=false", "run.dir=run")


@pytest.mark.parametrize("plan", ["default", "corridor", "hall"])
def test_a_built_in_plan_has_nothing_to_say(plan: str) -> None:
    assert notices(compose([f"env.plan={plan}", "env.robots=4"])) == []


LATE = "of the starts are more slots away from their destination, and no robot arrives from there."


def test_starts_that_are_too_far_are_a_line_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    room = ["env.robots=2", "env.room.width_m=100", "env.room.depth_m=100", "env.room.cell_m=2"]
    assert main(["train", *SHORT, *QUIET, *room, "env.motion.max_slots=25"]) == 0
    lines = capsys.readouterr().out.splitlines()
    said = next(line for line in lines if line.startswith("note: "))
    assert said == f"note: env.motion.max_slots=25: 75 % {LATE}"
    assert lines.index(said) == 1  # below the run's folder


def test_a_few_starts_are_under_one_per_cent() -> None:
    assert notices(compose(["env.motion.max_slots=89", "env.robots=1"])) == []
    [line] = notices(compose(["env.motion.max_slots=88", "env.robots=1"]))
    assert line == f"env.motion.max_slots=88: under 1 % {LATE}"


def test_the_share_follows_the_destinations_that_the_seed_draws() -> None:
    drawn = ["env.tasks.destination=random", "env.motion.max_slots=50"]
    assert len({notices(compose([*drawn, f"seed={seed}"]))[0] for seed in range(4)}) == 4


def test_no_robot_can_arrive_in_ten_slots() -> None:
    for destination in ("fixed", "random", "common"):
        with pytest.raises(ConfigError, match=r"^env\.motion\.max_slots=10: allowed is at least "):
            compose(["env.motion.max_slots=10", f"env.tasks.destination={destination}"])


def test_a_device_behind_walls_from_everything_is_a_line() -> None:
    cell = "[[10,10,12,10],[12,10,12,12],[12,12,10,12],[10,12,10,10]]"
    solid = [f"env.walls.segments={cell}", "env.walls.block_motion=true"]
    [seen, fed] = notices(compose([*solid, "env.ris.position_m=[11,11,2]"]))
    where = "env.ris.position_m=[11.0, 11.0, 2.0]: "
    assert seen == f"{where}no cell that robots reach is in the RIS's line of sight."
    assert fed == f"{where}the AP is not in the RIS's line of sight."
    assert notices(compose([*solid, "env.ris.position_m=[11,11,2]", "env.ris.side=0"])) == []
    [seen, _] = notices(compose([*solid, "env.ap.position_m=[11,11,2]"]))
    assert seen.endswith("in the AP's line of sight.")


def test_walls_outside_of_the_room_are_a_line() -> None:
    segments = "env.walls.segments=[[0,15,21,15],[0,3000,2100,3000],[31,0,31,30]]"
    [line] = notices(compose([segments]))
    say = "2 of 3 lie outside of the room of 30 m x 30 m and do nothing."
    assert line == f"env.walls.segments: {say}"
