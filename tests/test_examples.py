"""The examples in docs/examples train what they say."""

import csv
import importlib.util
import math
import random
import subprocess
import sys

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from torchrl.envs.utils import check_env_specs  # type: ignore[import-untyped]

from conf.overrides import FOLDER
from env.checks import checked_config
from env.geometry.floor import Floor
from env.oracles.per_slot import shortest_directions
from env.radio.propagation import (
    array_factor,
    element_offsets_m,
    far_excess_m,
    path_phase,
    wavelength_m,
)

EXAMPLES = FOLDER.parent / "docs" / "examples"


@pytest.fixture(autouse=True)
def _examples_find_each_other(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)


@pytest.fixture(autouse=True)
def _global_generator_as_found():
    """Stable-Baselines3 seeds all global generators; what follows is not to notice."""
    python, legacy = random.getstate(), np.random.get_state()  # noqa: NPY002  # SB3's seed
    with torch.random.fork_rng():
        yield
    random.setstate(python)
    np.random.set_state(legacy)  # noqa: NPY002  # SB3's seed


def example(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def weights(network):
    return torch.cat([values.detach().flatten() for values in network.parameters()])


def finite(*scores):
    return all(math.isfinite(score.reward) and 0 <= score.success <= 1 for score in scores)


def test_stable_baselines3_trains_on_the_single_robot():
    sb3 = example("sb3_dqn")
    start = weights(sb3.learner(0, 300).q_net)
    model, before, after = sb3.train(300, seed=0, episodes=2)
    assert model.num_timesteps == 300
    assert torch.isfinite(weights(model.q_net)).all()
    assert (weights(model.q_net) != start).any()
    assert finite(before, after)


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested")
def test_torchrl_trains_robots_and_access_point():
    fleet = example("torchrl_fleet")
    state = torch.get_rng_state()
    untrained, *_ = fleet.train(0, seed=0, episodes=1)
    assert (torch.get_rng_state() == state).all()
    trained, before, after = fleet.train(200, seed=0, episodes=1)
    assert [learner.group for learner in trained] == ["robots", "access_point"]
    for old, new in zip(untrained, trained, strict=True):
        assert torch.isfinite(weights(new.actor)).all()
        assert (weights(new.actor) != weights(old.actor)).any()
    assert len(trained[0].replay) == 2 * len(trained[1].replay) == 400
    assert finite(before, after)


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested")
def test_torchrls_own_wrapper_takes_the_fleet_as_it_is():
    fleet = example("torchrl_fleet")
    view, twin = (fleet.env.RISFleetParallelEnv({"robots": 2}) for _ in range(2))
    goals = view.world.floor.centres()[view.world.destinations]
    options = {"starts_m": (goals - [[0.5, 0.0], [1.5, 0.0]]).tolist()}
    groups = {"robots": view.robots, "access_point": [fleet.AP]}
    made = fleet.PettingZooWrapper(view, group_map=groups, use_mask=True, done_on_any=False)
    slot, (_, infos) = made.reset(options=options), twin.reset(options=options)
    for _ in range(3):
        for name in twin.agents:
            group = "access_point" if name == fleet.AP else "robots"
            row = 0 if name == fleet.AP else view.robots.index(name)
            seen = {key: float(column[row]) for key, column in slot[group, "info"].items()}
            told = {key: float(value) for key, value in infos[name].items()}
            assert seen == pytest.approx(told, rel=1e-6)
        assert slot["robots", "mask"].tolist() == [name in twin.agents for name in twin.robots]
        slot["robots", "action"] = torch.full((2,), 12)  # east, at the highest power
        slot["access_point", "action"] = torch.zeros(1, dtype=torch.int64)
        moves = dict.fromkeys(twin.robots, 12) | {fleet.AP: 0}
        _, slot = made.step_and_maybe_reset(slot)
        *_, infos = twin.step(moves)


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested")
def test_torchrls_own_wrapper_takes_robots_that_stay_without_a_mask_of_agents():
    fleet = example("torchrl_fleet")
    view = fleet.env.RISFleetParallelEnv(
        {"robots": 2, "motion": {"max_slots": 120}}, absorbing=True
    )
    goals = view.world.floor.centres()[view.world.destinations]
    options = {"starts_m": (goals - [[0.5, 0.0], [1.5, 0.0]]).tolist()}
    groups = {"robots": view.robots, "access_point": [fleet.AP]}
    made = fleet.PettingZooWrapper(view, group_map=groups, return_state=True, done_on_any=False)
    slot, masks, paid, ends = made.reset(options=options), [], [], []
    for _ in range(3):
        slot["robots", "action"] = torch.full((2,), 12)  # east, at the highest power
        slot["access_point", "action"] = torch.zeros(1, dtype=torch.int64)
        slot = made.step(slot)["next"]
        masks.append(slot["robots", "action_mask"].sum(-1).tolist())
        paid.append((slot["robots", "reward"][:, 0] != 0).tolist())
        ends.append(slot["done"].item())
    assert masks == [[1, 24], [1, 24], [24, 24]]  # TorchRL masks nobody once all are gone
    assert paid == [[True, True], [False, True], [False, True]]
    assert ends == [False, False, True]
    assert slot["state"].tolist() == [0.0] * 16


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested")
def test_torchrl_learns_nothing_from_robots_that_have_arrived():
    fleet = example("torchrl_fleet")
    view = fleet.env.RISFleetParallelEnv({"robots": 2})
    goals = view.world.floor.centres()[view.world.destinations]
    starts = (goals - [[0.5, 0.0], [1.5, 0.0]]).tolist()
    groups = {"robots": view.possible_agents[:-1], "access_point": [fleet.AP]}
    wrapped = fleet.PettingZooWrapper(view, group_map=groups, use_mask=True, done_on_any=False)
    slot = wrapped.reset(options={"starts_m": starts})
    learner, kept = fleet.Learner(wrapped, "robots", 10), []
    for _ in range(3):
        slot["robots", "action"] = torch.full((2,), 12)  # east, at the highest power
        slot["access_point", "action"] = torch.zeros(1, dtype=torch.int64)
        slot, following = wrapped.step_and_maybe_reset(slot)
        learner.remember(slot)
        kept.append(len(learner.replay))
        slot = following
    assert kept == [2, 3, 4]
    memory = learner.replay[:]
    assert memory["next", "terminated"].flatten().tolist() == [True, False, False, True]
    assert (memory["next", "reward"].flatten()[[0, 3]] > 4).all()  # the goal's 100, scaled


SMALL = (
    "+env.robots=2",
    "+env.motion.max_slots=12",
    "+env.tasks.start_distance_m=1.0",
    "evaluate_every=60",
    "experiment.max_n_frames=60",
    "experiment.off_policy_collected_frames_per_batch=30",
    "experiment.off_policy_n_optimizer_steps=2",
    "experiment.off_policy_train_batch_size=16",
    "experiment.off_policy_init_random_frames=0",
    "experiment.on_policy_collected_frames_per_batch=30",
    "experiment.on_policy_minibatch_size=15",
)
"""A run of BenchMARL's of two batches, evaluated at its end."""


def settings_of(algorithm, *more):
    with initialize_config_dir(str(EXAMPLES), version_base=None):
        return compose("benchmarl_fleet", [f"algorithm={algorithm}", *SMALL, *more])


def test_worlds_in_a_batch_are_the_absorbing_fleet_to_the_bit():
    fleet = example("benchmarl_fleet")
    config = {"robots": 3, "motion": {"max_slots": 60}}
    worlds = fleet.FleetWorlds(config, 1, 0)
    view = fleet.env.RISFleetParallelEnv(config, absorbing=True)
    worlds.set_seed(4)
    slot, (seen, infos) = worlds.reset(), view.reset(seed=4)
    random, arrivals = np.random.default_rng(0), 0
    while view.agents:
        for group, names in ((fleet.ROBOTS, view.robots), (fleet.ACCESS_POINT, [fleet.AP])):
            np.testing.assert_array_equal(slot[group, "observation"][0], [seen[n] for n in names])
            masks = [infos[name]["action_mask"] for name in names]
            np.testing.assert_array_equal(slot[group, "action_mask"][0], masks)
        np.testing.assert_array_equal(slot["state"][0], view.state())
        direction, level = shortest_directions(view.world)[0], random.integers(1, 7, size=3)
        picks = [view.world.scenario.actions.encode(direction, level).tolist()]
        actions = dict(zip(view.robots, *picks, strict=True)) | {fleet.AP: int(random.integers(4))}
        slot[fleet.ROBOTS, "action"] = torch.tensor(picks)
        slot[fleet.ACCESS_POINT, "action"] = torch.tensor([[actions[fleet.AP]]])
        slot = worlds.step(slot)["next"]
        seen, paid, ended, late, infos = view.step(actions)
        due = np.array([paid[name] for name in view.robots], np.float32)
        np.testing.assert_array_equal(slot[fleet.ROBOTS, "reward"][0, :, 0], due)
        assert slot[fleet.ACCESS_POINT, "reward"].item() == np.float32(paid[fleet.AP])
        ends = [slot[name].item() for name in ("terminated", "truncated", "done")]
        assert ends == [ended[fleet.AP], late[fleet.AP], not view.agents]
        arrivals += sum(infos[name]["arrived"] for name in view.robots)
    assert arrivals


def test_worlds_in_a_batch_keep_torchrls_rules_and_begin_anew_one_by_one():
    fleet = example("benchmarl_fleet")
    config = {"motion": {"max_slots": 3}, "tasks": {"start_distance_m": 1.0}}
    worlds = fleet.FleetWorlds(config, 3, 0)
    check_env_specs(worlds)
    slot = worlds.reset()
    worlds.world.slot = np.array([0, 2, 1])
    slot = worlds.rand_action(slot)
    _, following = worlds.step_and_maybe_reset(slot)
    assert worlds.world.slot.tolist() == [1, 0, 2]
    assert not following["done"].any()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("env.robots=0", r"env\.robots=0: allowed is a number from 1 to 64"),
        (
            "evaluate_every=45",
            "evaluate_every=45: allowed is a multiple of the 30 slots in a batch",
        ),
    ],
)
def test_what_benchmarl_cannot_train_is_named(wrong, said, tmp_path):
    fleet = example("benchmarl_fleet")
    with pytest.raises(ValueError, match=said):
        fleet.train(settings_of("iql", wrong), tmp_path)
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(
    "algorithm",
    ["qmix", *(pytest.param(name, marks=pytest.mark.slow) for name in ("mappo", "vdn", "iql"))],
)
def test_benchmarl_trains_robots_and_access_point(algorithm, tmp_path):
    fleet = example("benchmarl_fleet")  # with it BenchMARL's own settings are known
    settings = settings_of(algorithm)
    trained = fleet.train(settings, tmp_path)
    assert trained.total_frames == 60
    assert list(trained.group_map) == [fleet.ROBOTS, fleet.ACCESS_POINT]
    settings.experiment.lr = 0.0
    still = fleet.train(settings, tmp_path / "still")
    for group in trained.group_map:
        learned, first = (weights(made.group_policies[group]) for made in (trained, still))
        assert torch.isfinite(learned).all()
        assert (learned != first).any()
    with (tmp_path / fleet.EVALUATIONS).open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["tick"], row["epsilon"]) for row in rows] == [("60", "0.05"), ("60", "0.0")]
    assert all(0 <= float(row["success"]) <= 1 and float(row["ee"]) > 0 for row in rows)


def test_the_table_has_the_means_of_the_last_evaluations_and_when_runs_converged(tmp_path):
    table = example("benchmarl_table")
    for name, successes in (("qmix-0", [0, 0.9, 1, 1, 1, 0.9, 0.7]), ("qmix-1", [0.5] * 7)):
        (tmp_path / name).mkdir()
        with (tmp_path / name / "evaluations.csv").open("w") as file:
            file.write("tick,epsilon,success,ee\n")
            for at, success in enumerate(successes):
                file.writelines(f"{700 * at},{e},{success - e},0.1\n" for e in (0.05, 0.0))
    *_, line = table.table(tmp_path).splitlines()
    assert line == "| QMIX | 0.87 0.45 | 0.66 | 0.45 | 0.71 | 0.100 0.100 | 0.100 | 1400 never |"


@pytest.mark.slow
def test_one_command_trains_a_sweep(tmp_path):
    program = str(EXAMPLES / "benchmarl_fleet.py")
    command = [sys.executable, program, "-m", "algorithm=iql", "seed=0,1"]
    subprocess.run([*command, *SMALL, f"hydra.sweep.dir={tmp_path}"], check=True)
    assert {path.parent.name for path in tmp_path.glob("*/evaluations.csv")} == {"iql-0", "iql-1"}


@pytest.mark.slow
def test_stable_baselines3_learns_to_arrive():
    _, before, after = example("sb3_dqn").train(12_000, seed=0, episodes=50)
    assert after.success >= before.success + 0.5
    assert after.reward > before.reward + 50


def test_sionna_rt_in_free_space_gives_friis_and_plane_waves(tmp_path):
    pytest.importorskip("sionna.rt", reason="sionna-rt is not installed")
    room = {
        "room": {"width_m": 6.0, "depth_m": 4.0, "cell_m": 1.0},
        "walls": {"segments": []},
        "ap": {"position_m": [3.0, 4.0, 2.0]},
        "ris": {"position_m": [6.0, 2.0, 2.0], "side": 4, "subsurfaces": 2},
        "tasks": {"destinations_m": [[0.5, 0.5]], "start_distance_m": 1.0},
        "robots": 1,
    }
    overrides = [f"env.{key}={value}" for key, value in flat(room)]
    file = tmp_path / "free.npz"
    command = [sys.executable, str(EXAMPLES / "sionna_channels.py"), str(file), *overrides]
    subprocess.run([*command, "--free-space", "--depth", "0"], check=True)
    config = checked_config(room)
    floor, length_m = Floor.from_config(config), wavelength_m(config.channel.frequency_ghz)
    at = np.column_stack([floor.centres(), np.full(floor.cells, config.motion.antenna_height_m)])
    ap, ris = np.array(config.ap.position_m), np.array(config.ris.position_m)

    def friis(way_m):
        return length_m / (4 * np.pi * way_m) * path_phase(way_m, length_m)

    content = np.load(file)
    direct = friis(np.linalg.norm(at - ap, axis=1))
    assert content["direct"] == pytest.approx(direct, rel=1e-3)
    offsets = element_offsets_m(4, length_m / 2, "y")
    factor = array_factor(ap - ris, at - ris, offsets, 2, length_m, far_excess_m)
    one = friis(np.linalg.norm(ap - ris)) * friis(np.linalg.norm(at - ris, axis=1))
    expected = one[:, None] * factor
    assert content["reflected"] == pytest.approx(expected, abs=1e-3 * np.abs(expected).max())


def flat(values, above=""):
    """Keys with dots and their values."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from flat(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", str(value).replace(" ", "")
