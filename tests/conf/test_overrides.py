"""Overrides: parsed once, paths taken as the file system takes them, Hydra's own keys refused."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from conf import ConfigError, compose
from conf.overrides import combinations, parse
from conf.user_paths import pasted, resumed_folder, user_path, with_quoted_path

PATHS = st.text(
    st.characters(exclude_categories=["Cs"], exclude_characters="\0"), min_size=1, max_size=20
)
"""What a file system takes, as far as a command line can carry it."""


def folder_of(text: str) -> str | None:
    """``run.dir`` as an override sets it."""
    [override] = parse([text])
    value = override.value()
    assert value is None or isinstance(value, str)
    return value


# --- Paths ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "path",
    [
        "/tmp/größe2",
        "/tmp/lr=0.1",
        "/tmp/my run",
        "/tmp/a,b",
        "/tmp/it's",
        '/tmp/"so"',
        "/tmp/back\\slash\\",
        "/tmp/[1]{2}(3)",
        "/tmp/#x;y&z",
        "a:b",
        "0",
    ],
)
def test_a_path_is_what_the_file_system_takes_quoted_or_not(path: str) -> None:
    assert compose([f"run.dir={path}"]).run.dir == path
    assert folder_of(f"++run.dir={path}") == path
    quoted = with_quoted_path(f"run.dir={path}").partition("=")[2]
    assert folder_of(f"run.dir={quoted}") == path
    assert str(user_path(path)) == str(user_path(quoted)) == str(Path(path))


@given(path=PATHS)
@example(path="'")
@example(path="\\'")
@example(path="'a'b'")
def test_any_path_comes_back_as_it_was_written(path: str) -> None:
    path = "/" + path  # no home, no quotes around all of it, no null
    assert folder_of(f"run.dir={path}") == path
    assert resumed_folder(f"resume={path}") == Path(path)
    again = shlex.split(pasted("run.dir", Path(path)))
    assert again == [f"run.dir={Path(path)}"]


@pytest.mark.parametrize("text", ["~/t", "'~/t'", '"~/t"'])
def test_the_home_folder_is_expanded_quoted_or_not(
    text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", "/home/somebody")
    assert folder_of(f"run.dir={text}") == "/home/somebody/t"
    assert compose([f"run.dir={text}"]).run.dir == "/home/somebody/t"
    assert resumed_folder(f"resume={text}") == user_path(text) == Path("/home/somebody/t")


def test_the_home_of_nobody_stays_as_it_is() -> None:
    assert user_path("~no-such-user/x") == Path("~no-such-user/x")


def test_null_is_no_path_and_an_empty_one_is_refused() -> None:
    assert folder_of("run.dir=null") is None
    assert folder_of("run.dir='null'") == "null"
    with pytest.raises(ConfigError, match=r"run\.dir=: allowed is a path"):
        parse(["run.dir="])


def test_a_floor_plan_is_found_under_any_name(tmp_path: Path) -> None:
    plan = tmp_path / "ein Flur, größer=besser.toml"
    plan.write_text("[room]\nwidth_m = 31.0\n", encoding="utf-8")
    assert compose([f"env.plan={plan}"]).env.room.width_m == 31.0


def test_a_plans_name_may_hold_blanks_and_commas_in_a_sweep_too(tmp_path: Path) -> None:
    plans = [tmp_path / "a b.toml", tmp_path / "it's, [mine].toml"]
    for plan in plans:
        plan.touch()
        [override] = parse([f"env.plan={plan}"], sweep=True)
        assert override.value() == str(plan)
    listed = parse([f"env.plan=hall,{plans[0]},'{tmp_path}/c,d.toml'"], sweep=True)[0]
    assert listed.is_sweep_override()
    assert len(combinations([listed])) == 3


def test_plans_are_listed_in_a_sweep_alone(tmp_path: Path) -> None:
    plan = tmp_path / "größe.toml"
    plan.touch()
    listed = parse([f"env.plan=hall,{plan}"], sweep=True)
    assert [compose(each).env.plan for each in combinations(listed)] == ["hall", str(plan)]
    with pytest.raises(ConfigError, match="lists several values"):
        parse(["env.plan=hall,corridor"])


# --- Sweeps ---------------------------------------------------------------------------------------


def test_combinations_vary_the_last_key_fastest() -> None:
    listed = parse(["env.robots=2,3", "seed=range(0,2)", "run.dir=/a,b"], sweep=True)
    assert combinations(listed[:2]) == [
        ["env.robots=2", "seed=0"],
        ["env.robots=2", "seed=1"],
        ["env.robots=3", "seed=0"],
        ["env.robots=3", "seed=1"],
    ]
    assert listed[2].value() == "/a,b"


def test_an_interval_cannot_be_listed() -> None:
    with pytest.raises(ConfigError, match=r"interval\(0,1\): allowed in a sweep are values"):
        combinations(parse(["agent.learning_rate=interval(0,1)"], sweep=True))


def test_functions_without_assertions_are_refused_in_a_sentence() -> None:
    command = [sys.executable, "-O", "-m", "experiments.cli", "train", "-m", "seed=range(0,2)"]
    ended = subprocess.run(
        command, capture_output=True, text=True, cwd=Path(__file__).parents[2], check=False
    )
    assert ended.returncode == 2
    assert ended.stderr.startswith("risfleet: seed=range(0,2): range() and other functions need")
    assert ended.stderr.count("\n") == 1


# --- Hydra's own keys -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "say"),
    [
        ("hydra.run.dir=/x", "allowed is run.dir=FOLDER"),
        ("++hydra.sweep.dir=/x", "allowed is run.dir=FOLDER"),
        ("hydra.mode=MULTIRUN", "Hydra's own have no effect here"),
        ("hydra/launcher=joblib", "Hydra's own have no effect here"),
        ("hydra.verbose=true", "Hydra's own have no effect here"),
    ],
)
def test_hydras_keys_are_refused_where_they_have_no_effect(text: str, say: str) -> None:
    with pytest.raises(ConfigError) as refused:
        compose([text])
    assert say in str(refused.value)


def test_a_launcher_is_taken_where_there_is_one_and_nothing_else_of_hydras() -> None:
    parse(["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"], sweep=True, launcher=True)
    for text in ("hydra.mode=RUN", "hydra/sweeper=basic", "hydra.job.name=x"):
        with pytest.raises(ConfigError, match="no other has an effect"):
            parse([text], sweep=True, launcher=True)
    with pytest.raises(ConfigError, match="one launcher"):
        parse(["hydra/launcher=joblib,basic"], sweep=True, launcher=True)
