"""The benchmarks that need no further process run in their quick form and report numbers."""

import json
import math

import numpy as np
import pytest

from benchmarks import distance, engine, env_step, memory
from benchmarks.__main__ import known, main
from benchmarks.local import configured
from benchmarks.lockstep import PartedRun, Tick, shortest
from benchmarks.overheads import Kept, fill
from benchmarks.sockets import echoing
from client_app.robots import RobotGroup
from storage.checkpoint_files import checkpoints
from storage.checkpoint_layout import robot_folder, server_folder


@pytest.mark.parametrize(
    "name",
    [
        "engine",
        "env_step",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("parts", "scaling", "rooms", "central")
        ),
    ],
)
def test_a_benchmark_reports_finite_positive_numbers(name, tmp_path, monkeypatch):
    monkeypatch.setattr(env_step, "BATCH", 8)
    monkeypatch.setattr(engine, "WIDTHS", {64: engine.WIDTHS[64]})
    path = tmp_path / "bench.json"
    assert main(["--quick", "--only", name, "--json", str(path)]) == 0
    report = json.loads(path.read_text())
    assert report["failed"] == {}
    assert report["results"]
    for result in report["results"]:
        assert report[result["name"]] == result["value"]
        for number in (result["value"], result["low"], result["high"], *result["details"].values()):
            assert math.isfinite(number)
            assert number > 0


@pytest.mark.parametrize(
    ("result", "benchmark"),
    [
        ("world_step_vs_cartpole_k3", "env_step"),
        ("link_share", "deployment"),
        ("runs", "runs"),
        ("deployment_vs_simulation", "runs"),
        ("tls_us", "overheads"),
        ("lockstep_efficiency", "deployment"),
        ("lockstep_of_bound_k3", "lockstep"),
    ],
)
def test_a_result_chooses_the_benchmark_that_finds_it(result, benchmark):
    assert known(result) == benchmark


def test_an_unknown_name_ends_the_command_with_a_message(capsys):
    with pytest.raises(SystemExit):
        main(["--only", "nothing"])
    assert "'nothing'" in capsys.readouterr().err


def test_what_cannot_be_measured_here_is_skipped_with_a_word(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(distance, "obstacle", lambda: "no hosts today")
    path = tmp_path / "bench.json"
    assert main(["--only", "distance", "--json", str(path)]) == 0
    assert "skipped: no hosts today" in capsys.readouterr().out
    report = json.loads(path.read_text())
    assert report["results"] == []
    assert report["failed"] == {}


@pytest.mark.parametrize(("every", "kept"), [(2, [2, 4]), (None, [])])
def test_the_price_of_checkpoints_is_that_of_writing_them_all(every, kept, tmp_path):
    small = ["agent.replay_size=300", "agent.hidden=[8]", "env.ris.side=2", "env.ris.subsurfaces=2"]
    written = "null" if every is None else every
    run = Kept(configured(*small, f"state.every={written}"), tmp_path)
    run.play(4 * 25)  # windows 2 to 5: half of state.every lies before them
    run.close()
    assert checkpoints(server_folder(tmp_path)) == kept
    for robot in range(3):
        assert checkpoints(robot_folder(tmp_path, robot))[-2:] == (kept or [1])


def test_filled_replays_are_full_and_the_agents_learn_from_them():
    config = configured("agent.replay_size=300", "agent.hidden=[8]")
    group = RobotGroup(config, (0,))
    fill(group.agents, config)
    assert len(group.agents.agent_state(0)["replay"]) == 300
    nothing, one = np.zeros((1, 5), np.float32), np.ones(1, np.int32)
    losses = group.agents.learn(nothing, one, one, nothing, one == 0, one == 1)
    assert np.isfinite(losses).all()


def test_memory_is_told_apart_by_what_a_process_is_to_flower(tmp_path, monkeypatch):
    monkeypatch.setattr(memory, "PROC", tmp_path)
    commands = {
        1: "python flower-superlink --insecure",
        2: "python flower-supernode --insecure",
        3: "flower-superexec",
        4: "flower-superexec",
        5: "python flwr-clientapp",
        6: "sleep 1",
    }
    parents = {3: 1, 4: 2}
    for pid, command in commands.items():
        (tmp_path / str(pid)).mkdir()
        (tmp_path / str(pid) / "cmdline").write_text(command.replace(" ", "\0"))
        (tmp_path / str(pid) / "stat").write_text(f"{pid} (a b) S {parents.get(pid, 0)} 1")
    assert [memory._role(tmp_path / str(pid)) for pid in commands] == [
        "superlink", "supernode", "superlink_superexec", "supernode_superexec", "client_app", "",
    ]  # fmt: skip


def test_no_schedule_beats_the_bound_on_lockstep():
    tick = Tick(serial=100e-6, ap=200e-6, robots=np.full(3, 200e-6), exchange=50e-6)
    assert tick.bound(2) == pytest.approx(450 / (100 + 50 + 400))  # 900 us of work on two cores
    assert tick.bound(4) == pytest.approx(300 / (100 + 50 + 200))  # the server's own 300 us
    assert tick.bound(1) == pytest.approx(900 / 950)  # one core is never idle but for the exchange
    free = Tick(serial=0.0, ap=0.0, robots=np.array([200e-6]), exchange=0.0)
    assert free.bound(2) == 1.0


def test_the_parts_of_a_tick_are_timed_apart():
    run = PartedRun(configured("agent.hidden=[8]", "agent.replay_size=300"))
    serial_s, ap_s, robots_s = run.parts(150)
    assert robots_s.shape == (3,)
    assert min(serial_s, ap_s, *robots_s) > 0


def test_bare_sockets_answer_each_exchange():
    with echoing(2, (40, 20)) as bare:
        bare(20)


def test_the_shortest_time_is_that_of_the_largest_piece_or_of_full_cores():
    assert shortest([3.0, 1.0, 1.0], 2) == 3.0
    assert shortest([2.0, 2.0, 2.0], 2) == 3.0
