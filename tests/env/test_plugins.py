"""Rewards and channel models of the user's own: found by name, checked, the same on every side."""

import json
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import env
from conf import ConfigError, compose, fingerprint
from env import plugins
from env.checks import checked_config
from env.local_env import LocalEnv
from env.mdp import reward
from env.radio.radio_map import build_radio_map
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World
from experiments.cli import main

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text()
MODULE, SCRIPT = re.findall(r"```python\n(.*?)```", PAGE, re.S)
(PROJECT,) = re.findall(r"```toml\n(.*?)```", PAGE, re.S)
SHELL, *_ = re.findall(r"```sh\n(.*?)```", PAGE, re.S)
BASE = {"robots": 3, "motion": {"max_slots": 40}}


@pytest.fixture(autouse=True)
def _nothing_registered(monkeypatch):
    for models in (plugins._CHANNELS, plugins._REWARDS):
        monkeypatch.setattr(models, "_registered", {})


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Installs a package as pip does: its module and its dist-info in a folder on the path."""

    def make(module=MODULE, project=PROJECT, folder="site"):
        written = tomllib.loads(project)["project"]
        info = (
            tmp_path
            / folder
            / f"{written['name'].replace('-', '_')}-{written['version']}.dist-info"
        )
        info.mkdir(parents=True, exist_ok=True)
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {written['name']}\nVersion: {written['version']}\n"
        )
        lines = [
            line
            for group, entries in written["entry-points"].items()
            for line in (f"[{group}]", *(f"{name} = {at}" for name, at in entries.items()))
        ]
        (info / "entry_points.txt").write_text("\n".join(lines))
        (tmp_path / folder / "my_lab.py").write_text(module)
        monkeypatch.syspath_prepend(tmp_path / folder)
        monkeypatch.delitem(sys.modules, "my_lab", raising=False)

    yield make
    sys.modules.pop("my_lab", None)


def squared(rate, before_m, after_m, arrived, weights):
    return weights.rate * rate * rate + np.exp(after_m - before_m) + np.where(arrived, 7.0, 0.0)


def ramp(config, floor):
    """Channels that are known by hand: 1 mW to 2 mW over the cells, the RIS a tenth of j."""
    direct = np.linspace(1e-3, 2e-3, floor.cells) + 0j
    return direct, np.full((floor.cells, config.ris.subsurfaces), 1e-4j)


def world_of(changes):
    config = checked_config({**BASE, **changes})
    return World(Scenario.drawn(config, 0), stream(0, Stream.WORLD), worlds=5)


def slots(world, count=40):
    """Random slots: what each brought, with the cells before and after."""
    world.reset()
    picks = np.random.default_rng(1)
    for _ in range(count):
        left = world.cell.copy()
        shape = left.shape
        outcome = world.step(
            picks.integers(world.phase_actions, size=shape[0]),
            picks.integers(4, size=shape),
            picks.integers(1, 7, size=shape),
        )
        yield outcome, left, world.cell.copy()


# --- What a model does ----------------------------------------------------------------------------


def test_an_own_reward_has_equal_bits_in_the_world_and_on_a_robot():
    env.register_reward("squared", squared)
    world = world_of({"reward": {"model": "squared"}})
    for outcome, left, reached in slots(world):
        for b in range(len(left)):
            mine = LocalEnv(Scenario(world.config, world.destinations))
            made = mine.reward(outcome.rate[b], left[b], reached[b], outcome.arrived[b])
            drove = outcome.drove[b]
            assert np.array_equal(made[drove], outcome.local_reward[b][drove])
            for k in np.flatnonzero(drove):
                alone = LocalEnv(Scenario(world.config, world.destinations[k : k + 1]))
                at = slice(k, k + 1)
                one = alone.reward(
                    outcome.rate[b, at], left[b, at], reached[b, at], outcome.arrived[b, at]
                )
                assert one[0] == outcome.local_reward[b, k]


def test_an_own_reward_is_what_robots_get_and_the_access_points_stays():
    env.register_reward("squared", squared)
    own, papers = world_of({"reward": {"model": "squared"}}), world_of({})
    for (mine, left, reached), (theirs, *_) in zip(slots(own), slots(papers), strict=True):
        before, after = (own._distance_m[cell, own._robot] for cell in (left, reached))
        expected = squared(mine.rate, before, after, mine.arrived, own.config.reward)
        assert np.array_equal(mine.local_reward, np.where(mine.drove, expected, 0.0))
        assert not np.array_equal(mine.local_reward, theirs.local_reward)
        assert np.array_equal(mine.global_reward, theirs.global_reward)
        assert np.array_equal(mine.rate, theirs.rate)


def test_a_reward_that_writes_to_what_it_is_given_changes_nothing():
    def greedy(rate, before_m, after_m, arrived, weights):
        rate *= 0.0
        after_m -= 1.0
        return rate + after_m

    env.register_reward("greedy", greedy)
    own, papers = world_of({"reward": {"model": "greedy"}}), world_of({})
    for (mine, *_), (theirs, *_) in zip(slots(own, 5), slots(papers, 5), strict=True):
        assert np.array_equal(mine.rate, theirs.rate)
        assert (mine.rate[mine.drove] > 0).all()


def test_an_own_channel_is_what_robots_have_and_lines_of_sight_stay_ours():
    env.register_channel_model("ramp", ramp)
    config = checked_config({"channel": {"model": "ramp"}, "ris": {"subsurfaces": 2}})
    mine, ours = (
        build_radio_map(config),
        build_radio_map(checked_config({"ris": {"subsurfaces": 2}})),
    )
    assert mine.direct[[0, -1]] == pytest.approx([1e-3, 2e-3])
    assert mine.direct_db[0] == pytest.approx(-60.0)
    # Both sub-surfaces at a phase of 45 degrees turn j to 135.
    assert mine.channel(np.array([0]), np.array(0)) == pytest.approx(
        [1e-3 + 2e-4 * np.exp(0.75j * np.pi)]
    )
    for name in ("direct_los", "ris_los", "settings"):
        assert np.array_equal(getattr(mine, name), getattr(ours, name))


def test_each_slots_fading_multiplies_an_own_channel():
    env.register_channel_model("ramp", ramp)
    world = world_of({"channel": {"model": "ramp", "fading": "slot"}})
    world.reset()
    assert np.array_equal(world.direct, world.radio_map.direct[world.cell] * world._fading.factor)
    assert not np.array_equal(world.direct, world.radio_map.direct[world.cell])


def test_without_a_ris_an_own_channel_has_none_either():
    env.register_channel_model("ramp", ramp)
    found = build_radio_map(checked_config({"channel": {"model": "ramp"}, "ris": {"side": 0}}))
    assert not found.reflected.any()
    assert found.direct.all()


def test_by_default_the_papers_function_itself_makes_rewards():
    world = world_of({})
    assert world._rewards._local is reward.local_reward
    assert (
        LocalEnv(Scenario(world.config, world.destinations))._rewards._local is reward.local_reward
    )
    assert plugins.own_channel(world.config, world.floor) is None


# --- Names ----------------------------------------------------------------------------------------


def test_a_package_is_found_by_its_entry_points(install):
    install()
    config = checked_config(
        {"reward": {"model": "diminishing"}, "channel": {"model": "free_space"}}
    )
    rate, metres = np.array([9.0]), np.array([2.0])
    made = reward.RewardFunction(config).of_robots(rate, metres, metres, np.array([True]))
    # 0.05 * 3 - 1 + 100.
    assert made == pytest.approx([99.15])
    # 0.125 m of wavelength, 2.4 GHz: the cell below the AP is 1 m lower and 0.25 m off both ways.
    distance = np.sqrt(1.0 + 2 * 0.25**2)
    cell = world_of({}).floor.cell_at(np.array([15.25, 29.75]))
    gain = abs(build_radio_map(config).direct[cell])
    assert gain == pytest.approx(0.299792458 / 2.4 / (4 * np.pi * distance), rel=1e-3)


@pytest.mark.parametrize(
    ("key", "ours", "register", "function"),
    [
        ("reward", "paper", env.register_reward, squared),
        ("channel", "indoor_hotspot, file", env.register_channel_model, ramp),
    ],
)
def test_an_unknown_name_is_refused_with_those_that_there_are(key, ours, register, function):
    register("mine", function)
    config = env.EnvConfig()
    with pytest.raises(
        ValueError, match=rf"^env\.{key}\.model='x': allowed is one of {ours}, mine$"
    ):
        checked_config({key: {"model": "x"}})
    with pytest.raises(
        ConfigError, match=rf"^env\.{key}\.model=x: allowed is one of {ours}, mine\.$"
    ):
        compose([f"env.{key}.model=x"])
    with pytest.raises(ValueError, match=rf"^env\.{key}\.model='os:system': allowed is one of"):
        checked_config({key: {"model": "os:system"}})
    assert plugins.problems(config) == []


def test_an_installed_package_cannot_take_the_papers_name(install):
    install(project=PROJECT.replace("diminishing =", "paper ="))
    assert world_of({})._rewards._local is reward.local_reward


@pytest.mark.parametrize("name", ["paper", "", "a b", "a=b", "os:system", "x" * 65, None])
def test_a_name_must_be_a_free_word(name):
    with pytest.raises(ValueError, match="allowed is a name other than paper"):
        env.register_reward(name, squared)


def test_only_functions_are_registered():
    with pytest.raises(ValueError, match=r"env\.channel\.model=x: allowed is a function, not str"):
        env.register_channel_model("x", "os:system")


@pytest.mark.parametrize(
    ("module", "say"),
    [
        (
            "import nowhere_at_all",
            "a model that loads: my_lab:diminishing gives ModuleNotFoundError",
        ),
        ("x = 1", "a model that loads: my_lab:diminishing gives AttributeError"),
        ("diminishing = 3", "a function, which my_lab:diminishing is not"),
    ],
)
def test_a_package_that_does_not_load_is_a_mistake_in_the_configuration(install, module, say):
    install(module)
    with pytest.raises(ConfigError, match=f"^env.reward.model=diminishing: allowed is {say}"):
        compose(["env.reward.model=diminishing"])


def test_a_name_that_two_packages_bring_is_refused(install):
    install()
    install(project=PROJECT.replace("my-lab", "other-lab"), folder="other")
    with pytest.raises(
        ValueError, match="allowed is a name that one package brings, not my_lab:dim"
    ):
        checked_config({"reward": {"model": "diminishing"}})


# --- What models must not give --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "say"),
    [
        (lambda rate, *_: rate[..., :1], "of shape (5, 3), not (5, 1)"),
        (lambda rate, *_: rate.astype(np.float32), "float64, not float32"),
        (lambda rate, *_: rate.tolist(), "an array, not list"),
        (lambda rate, *_: np.where(rate > 0, np.nan, 0.0), "finite everywhere"),
    ],
)
def test_a_wrong_reward_is_named(wrong, say):
    env.register_reward("wrong", wrong)
    told = f"env.reward.model=wrong: allowed is a model whose reward is {say}"
    with pytest.raises(ValueError, match=f"^{re.escape(told)}$"):
        next(slots(world_of({"reward": {"model": "wrong"}})))


def hole(direct):
    direct[7] = 0.0
    return direct


@pytest.mark.parametrize(
    ("wrong", "say"),
    [
        (lambda d, r: d, "that gives two tables, direct, reflected"),
        (lambda d, r: (d[1:], r), "whose direct is of shape (3600,), not (3599,)"),
        (lambda d, r: (d, r[:, 0]), "whose reflected is of shape (3600, 1), not (3600,)"),
        (lambda d, r: (abs(d), r), "whose direct is complex, not float64"),
        (lambda d, r: (d, r * np.inf), "whose reflected is finite everywhere"),
        (lambda d, r: (hole(d), r), "whose direct is nowhere zero"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_wrong_tables_are_named(wrong, say):
    env.register_channel_model("wrong", lambda config, floor: wrong(*ramp(config, floor)))
    told = f"env.channel.model=wrong: allowed is a model {say}"
    with pytest.raises(ValueError, match=f"^{re.escape(told)}$"):
        build_radio_map(checked_config({"channel": {"model": "wrong"}}))


# --- Two sides of a run ---------------------------------------------------------------------------


def test_the_fingerprint_tells_another_source_and_another_version(install):
    config = env.EnvConfig()
    assert fingerprint(config) == fingerprint()
    install()
    using = checked_config({"reward": {"model": "diminishing"}})
    first = fingerprint(using)
    assert re.fullmatch(
        re.escape(fingerprint())
        + r", env\.reward\.model=diminishing \(my-lab 1\.0, [0-9a-f]{12}\)",
        first,
    )
    install(MODULE + "\n# changed\n", folder="changed")
    changed = fingerprint(using)
    install(project=PROJECT.replace('"1.0"', '"1.1"'), folder="newer")
    assert "my-lab 1.1" in fingerprint(using)
    assert len({first, changed, fingerprint(using)}) == 3
    assert fingerprint(config) == fingerprint()


def test_what_a_script_registers_is_told_by_its_file():
    env.register_reward("squared", squared)
    env.register_channel_model("unwritten", eval("lambda config, floor: None"))
    config = checked_config({"reward": {"model": "squared"}, "channel": {"model": "unwritten"}})
    channel, robots = plugins.identities(config)
    assert channel == "env.channel.model=unwritten (no source file)"
    assert re.fullmatch(r"env\.reward\.model=squared \([0-9a-f]{12}\)", robots)


# --- Runs -----------------------------------------------------------------------------------------


def digests(folder):
    return json.loads((folder / "summary.json").read_text())["digest"]


def test_a_registered_reward_trains_other_weights(tmp_path, tiny_overrides):
    env.register_reward("squared", squared)
    env.register_reward("papers", reward.local_reward)
    for name in ("paper", "papers", "squared"):
        given = [f"env.reward.model={name}", "train.max_ticks=30", f"run.dir={tmp_path / name}"]
        assert main(["train", *tiny_overrides, *given]) == 0
    assert digests(tmp_path / "papers") == digests(tmp_path / "paper")
    assert digests(tmp_path / "squared")["robots"] != digests(tmp_path / "paper")["robots"]


def test_the_pages_package_trains_with_the_pages_command(install, tmp_path, tiny_overrides):
    install()
    folder = tmp_path / "run"
    (command,) = re.findall(r"^risfleet (.*)$", SHELL, re.M)
    given = [*command.split(), *tiny_overrides, "train.max_ticks=10", f"run.dir={folder}"]
    assert main(given) == 0
    written = json.loads((folder / "summary.json").read_text())["fingerprint"]
    assert "env.channel.model=free_space (my-lab 1.0" in written
    assert "env.reward.model=diminishing (my-lab 1.0" in written


def test_the_pages_script_trains(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "script"}
    exec(SCRIPT, names)
    assert names["status"] == 0
    assert names["fleet"].world.config.reward.model == "hurried"
    assert len([*tmp_path.glob("runs/*/summary.json")]) == 1


def test_a_run_does_not_go_on_with_another_source(install, tmp_path, tiny_overrides, capsys):
    install()
    folder = tmp_path / "run"
    given = ["env.reward.model=diminishing", "state.every=1", "train.max_ticks=20"]
    assert main(["train", *tiny_overrides, *given, f"run.dir={folder}"]) == 0
    install(MODULE + "\n# changed\n", folder="changed")
    assert main(["train", f"resume={folder}"]) == 2
    assert "torch and plug-ins on this type of CPU" in capsys.readouterr().err
    install(folder="again")
    assert main(["train", f"resume={folder}"]) == 2
    assert "plug-ins" not in capsys.readouterr().err
