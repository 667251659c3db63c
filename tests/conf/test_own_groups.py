"""Experiments, strategies and floor plans in folders of the user's own, beside ours."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import pytest

from conf import Config, ConfigError, compose
from conf.overrides import FOLDER, combinations, parse
from experiments.cli import main
from server_app.app import _asked
from training.run_folder import RunFolder

MINE = """\
# @package _global_
defaults:
  - override /strategy: slow
env:
  robots: 2
  plan: small.toml
"""
PLAN = (
    "[room]\nwidth_m = 8.0\ndepth_m = 6.0\n[walls]\nsegments = []\n[ap]\nposition_m = [4, 6, 2]\n"
)
PLAN += "[ris]\nposition_m = [8, 3, 2]\n[tasks]\ndestinations_m = [[1, 1], [7, 5]]\n"
PLAN += "start_distance_m = 2.0\n"


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A folder, with a blank in its name, of one experiment, one strategy and one plan."""
    folder = tmp_path / "my conf"
    for name, text in (
        ("experiment/mine.yaml", MINE),
        ("strategy/slow.yaml", "name: fedavgm\nserver_rate: 0.5\nmomentum: 0.5\n"),
        ("small.toml", PLAN),
    ):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


def searched(*folders: Path, scheme: str = "file://") -> str:
    return f"hydra.searchpath=[{','.join(repr(f'{scheme}{folder}') for folder in folders)}]"


def experiment(own: Path, text: str) -> Path:
    (own / "experiment" / "new.yaml").write_text(text)
    return own


@pytest.mark.parametrize("scheme", ["file://", ""])
def test_groups_and_plans_of_a_folder_are_found_beside_ours(own: Path, scheme: str) -> None:
    config = compose([searched(own, scheme=scheme), "experiment=mine", "baseline=no_ris"])
    assert (config.env.robots, config.env.ris.side) == (2, 0)
    assert (config.strategy.name, config.strategy.server_rate) == ("fedavgm", 0.5)
    assert config.env.plan == str(own / "small.toml")
    assert config.env.room.width_m == 8.0
    assert compose([searched(own), "strategy=slow", "env.plan=small.toml"]).env.room.depth_m == 6.0
    assert compose([searched(own), "rooms.count=2", "rooms.plans=[small.toml]"]).rooms.plans == [
        str(own / "small.toml")
    ]


def test_several_folders_are_searched(own: Path, tmp_path: Path) -> None:
    second = tmp_path / "second"
    (second / "experiment").mkdir(parents=True)
    (second / "experiment" / "other.yaml").write_text("# @package _global_\nseed: 9\n")
    found = compose([searched(own), "experiment=other", "strategy=slow", searched(second)])
    assert (found.seed, found.strategy.name) == (9, "fedavgm")


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("hydra.searchpath=[pkg://mine]", r"\[pkg://mine\]: allowed is a list of folders that ex"),
        ("hydra.searchpath=[file:///nowhere]", r"allowed is a list of folders that exist, as in"),
        ("hydra.searchpath=/tmp", r"hydra\.searchpath=/tmp: allowed is a list, \[file://DIR\]"),
        ("hydra.searchpath=[1],[2]", "allowed is a list"),
    ],
)
def test_what_cannot_be_searched_is_refused_in_a_sentence(override: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        parse([override, "experiment=mine"], sweep=True)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("# @package _global_\nenv: [\n", r"is no YAML: while parsing.*new\.yaml\", line 3"),
        ("# @package _global_\nenv:\n  robotz: 3\n", r"'experiment/new': Key 'robotz' .*env\.rob"),
        ("# @package _global_\nenv:\n  robots: many\n", r"'many' .* Integer \(env\.robots\)\.$"),
        ("# @package _global_\nenv:\n  robots: 99\n", "env.robots=99: allowed is a number from 1"),
        ("env:\n  robots: 2\n", r"\(is its first line '# @package _global_'\?\)\.$"),
        (
            "# @package _global_\ndefaults:\n  - override /strategy: nix\n",
            r"Could not find 'strategy/nix': allowed is one of .*, none, own, slow, visits\.$",
        ),
        ("# @package _global_\nhydra:\n  searchpath: [a]\n", "only supported from the primary"),
    ],
)
def test_what_is_wrong_in_a_file_is_said_in_a_line(own: Path, text: str, says: str) -> None:
    experiment(own, text)
    with pytest.raises(ConfigError, match=says) as error:
        compose([searched(own), "experiment=new"])
    assert "\n" not in str(error.value)


def test_a_name_of_ours_is_not_taken_twice(own: Path) -> None:
    (own / "experiment" / "quick.yaml").write_text(MINE)
    with pytest.raises(ConfigError, match="experiment=quick: allowed is a name that one file has"):
        compose([searched(own), "experiment=quick"])


def test_each_run_of_a_sweep_finds_the_folder(own: Path) -> None:
    listed = parse([searched(own), "experiment=mine", "strategy=slow,fedavg"], sweep=True)
    rates = [compose(each).strategy.name for each in combinations(listed)]
    assert rates == ["fedavgm", "fedavg"]


def test_a_server_app_composes_with_the_folder_too(own: Path) -> None:
    overrides = f'"{searched(own)}" experiment=mine'
    config, resumed = _asked(shlex.split(overrides))
    assert (config.env.robots, config.runtime.name, resumed) == (2, "simulation", None)


def test_a_run_and_its_resume_need_the_folder_no_longer(
    own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small = ("runtime=local", "train.max_ticks=50", "state.every=1", "run.figures=false")
    small += ("run.tensorboard=false", "evaluation.episodes=2", "env.motion.max_slots=30")
    run = tmp_path / "run"
    options = ["--config-dir", str(own), "experiment=mine", *small, f"run.dir={run}"]
    assert main(["train", *options]) == 0
    own.rename(tmp_path / "gone")
    kept: Config = RunFolder(run).read_config()
    assert (kept.env.room.width_m, kept.strategy.momentum) == (8.0, 0.5)
    assert main(["train", f"resume={run}", "train.max_ticks=100"]) == 0
    assert main(["evaluate", str(run), "--episodes", "2"]) == 0
    capsys.readouterr()
    assert main(["train", *options]) == 2
    assert capsys.readouterr().err == (
        f"risfleet: --config-dir {own}: allowed is a folder that exists.\n"
    )


@pytest.mark.parametrize(
    "command",
    [
        ["train", "--cfg", "--config-dir=DIR", "experiment=mine"],
        ["train", "--cfg", "experiment=mine", "-cd", "DIR"],
        ["map", "--config-dir", "DIR", "experiment=mine"],
        ["evaluate", "--episodes", "1", "baseline=short", "--config-dir", "DIR", "seed=1"],
        ["oracle", "--slack", "0", "experiment=mine", "--config-dir", "DIR", "--episodes", "1"],
    ],
)
def test_commands_that_compose_take_the_option_wherever_it_stands(
    command: list[str], own: Path
) -> None:
    (own / "baseline").mkdir()
    shutil.copy(FOLDER / "baseline" / "shortest_canonical.yaml", own / "baseline" / "short.yaml")
    assert main([item.replace("DIR", str(own)) for item in command]) == 0
