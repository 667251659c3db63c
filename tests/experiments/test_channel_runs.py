"""Runs with channels from a file: the model's own bits, in every command; a changed file."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from train_helpers import summary

from conf import compose
from conf.overrides import combinations, parse
from experiments.cli import main
from training.run_folder import RunFolder

N = "env.ris.subsurfaces=2"
NEAR = (N, "env.ris.response=near")


@pytest.fixture(scope="module")
def small(tiny_overrides: tuple[str, ...]) -> tuple[str, ...]:
    return (*tiny_overrides, "train.max_ticks=20")


@pytest.fixture(scope="module")
def written(small: tuple[str, ...], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The channels of our own ``near`` model, as ``risfleet map`` writes them, and others."""
    paths = [tmp_path_factory.mktemp("channels") / name for name in ("near.npz", "other.npz")]
    for path, changes in zip(paths, (NEAR, (N,)), strict=True):
        assert main(["map", *small, *changes, "--channels", str(path)]) == 0
    return paths[0], paths[1]


@pytest.fixture
def channels(written: tuple[Path, Path], tmp_path: Path) -> Path:
    """A copy of the first."""
    return Path(shutil.copy(written[0], tmp_path / "my channels.npz"))


def of(path: Path) -> tuple[str, ...]:
    return N, "env.channel.model=file", f"env.channel.file={path}"


def error(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line that was printed as an error."""
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line


def test_a_run_ends_in_the_bits_of_the_model_that_was_written(
    small: tuple[str, ...],
    channels: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    ours, own = tmp_path / "ours", tmp_path / "file"
    assert main(["train", *small, *NEAR, f"run.dir={ours}"]) == 0
    assert main(["train", *small, *of(channels), f"run.dir={own}"]) == 0
    assert summary(own)["digest"] == summary(ours)["digest"]
    kept = RunFolder(own).read_config().env.channel
    assert kept.file == str(channels)
    assert kept.sha256 is not None
    for command in (("oracle", "--slack", "0"), ("evaluate",)):
        files = [tmp_path / f"{folder.name}-{command[0]}.json" for folder in (ours, own)]
        for folder, file in zip((ours, own), files, strict=True):
            played = (str(folder), "--episodes", "2", "--json", str(file))
            assert main([command[0], *played, *command[1:]]) == 0
        assert files[0].read_text() == files[1].read_text()
    assert main(["map", *small, *of(channels), "--out", str(tmp_path / "m.png")]) == 0
    assert "from a file" in capsys.readouterr().out


def test_a_changed_file_is_refused_by_resume_and_evaluate(
    small: tuple[str, ...],
    channels: Path,
    written: tuple[Path, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "run"
    assert main(["train", *small, *of(channels), f"run.dir={folder}", "state.every=1"]) == 0
    longer = ["train", f"resume={folder}", "train.max_ticks=40"]
    assert main([*longer]) == 0
    shutil.copy(written[1], channels)
    for command in ([*longer[:2], "train.max_ticks=60"], ["evaluate", str(folder)]):
        capsys.readouterr()
        assert main(command) == 2
        line = error(capsys)
        assert line.startswith(f"risfleet: env.channel.file={channels}: allowed is the file whose")
        assert "with which the run began, and not" in line


def test_rooms_with_one_floor_share_a_file_and_others_are_refused(
    building_overrides: tuple[str, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "room.npz"
    alone = [item for item in building_overrides if not item.startswith("rooms.")]
    assert main(["map", *alone, "--channels", str(path)]) == 0
    own = ("env.channel.model=file", f"env.channel.file={path}")
    assert main(["train", *building_overrides, *own, f"run.dir={tmp_path / 'run'}"]) == 0
    capsys.readouterr()
    assert main(["train", "rooms.count=2", "rooms.plans=[hall]", *own]) == 2
    assert f"env.channel.file={path}: allowed is a file whose cells_m" in error(capsys)


def test_a_sweep_takes_several_files(
    small: tuple[str, ...], channels: Path, written: tuple[Path, Path]
) -> None:
    second = written[1]
    several = (*small, *of(channels)[:2], f"env.channel.file='{channels}',{second}")
    found = [compose(each).env.channel for each in combinations(parse(several, sweep=True))]
    assert [channel.file for channel in found] == [str(channels), str(second)]
    assert len({channel.sha256 for channel in found}) == 2


def test_what_cannot_be_written_is_said_before_anything_is_built(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["map", "--channels", str(tmp_path / "x.npy")]) == 2
    assert "allowed is a file that ends in .npz" in error(capsys)
    beams = ("env.ris.response=near", "env.ris.action=codebook")
    assert main(["map", *beams, "--channels", str(tmp_path / "x.npz")]) == 2
    assert "phases with --channels" in error(capsys)
