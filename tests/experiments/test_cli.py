"""The ``risfleet`` command: mistakes cost one sentence, and runs can be looked at afterwards."""

from __future__ import annotations

import json
import shutil
import socket
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import pytest

from conf import compose, from_yaml
from experiments.cli import main
from training.recording.history import MEASURES
from training.run_folder import RunFolder

Refused = Callable[..., str]


# --- Commands -------------------------------------------------------------------------------------


def test_an_unknown_command_names_those_that_exist(refused: Refused) -> None:
    assert "'trian' is no command: there are train, evaluate" in refused("trian")


def test_no_command_shows_the_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert main(["--help"]) == 0
    assert capsys.readouterr().out.count("usage: risfleet COMMAND") == 2


@pytest.mark.parametrize("flag", ["-h", "--help"])
@pytest.mark.parametrize("name", ["train", "status"])
def test_each_command_shows_its_usage(
    name: str, flag: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([name, flag]) == 0
    assert capsys.readouterr().out.startswith(f"usage: risfleet {name} ")


def test_evaluate_shows_its_usage(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["evaluate", "--help"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("usage: risfleet evaluate ")


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"risfleet {version('risfleet')}\n"


@pytest.mark.parametrize(
    ("mistake", "parts"),
    [
        ("env.robtos=3", ["env.robtos is no key", "did you mean env.robots"]),
        ("env.robots=three", ["env.robots=three", "a whole number"]),
        ("env.robots=0", ["env.robots=0", "from 1 to 64"]),
        ("agent.hidden=64", ["agent.hidden=64", "a list such as [64,64]"]),
        (
            "strategy=fedsgd",
            ["strategy=fedsgd", "bulyan, fedadam, fedavg, fedavgm, fedmedian, fedprox"],
        ),
        ("runtime=cloud", ["runtime=cloud", "local, simulation"]),
        ("env.power.levels=2", ["env.power.levels=2", "env.robots=3", "project"]),
        ("env.ris.subsurfaces=7", ["env.ris.subsurfaces=7", "divisor of the 900"]),
        ("env.tasks.destinations_m=[[99,1]]", ["[99,1]", "inside the room of 30 m x 30 m"]),
        ("strategy.proximal_mu=0.1", ["strategy.proximal_mu=0.1", "only fedprox reads it"]),
        ("strategy.momentum=0.5", ["strategy.momentum=0.5", "only fedavgm reads it"]),
        ("federation.clients=4", ["federation.clients=4", "from 1 to env.robots=3"]),
        ("seed", ["'seed' is not of the form key=value"]),
        ("+note=1", ["'+note=1'", "only set"]),
        ("env=[1]", ["env"]),
        ("--sweep", ["--sweep is no option"]),
    ],
)
def test_a_mistake_in_a_key_value_or_combination_is_one_sentence(
    refused: Refused, mistake: str, parts: list[str]
) -> None:
    said = refused("train", mistake)
    for part in parts:
        assert part in said


def test_several_values_need_a_sweep(refused: Refused) -> None:
    refused("train", "seed=0,1", "runtime=local")


def test_krum_needs_three_robots(refused: Refused) -> None:
    assert "env.robots of at least 3, not 2" in refused("train", "strategy=krum", "env.robots=2")


def test_more_clients_than_flowers_engine_runs_are_refused(
    refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("training.engine_limits.os.cpu_count", lambda: 1)
    said = refused("train", "env.robots=6", "federation.clients=6")
    assert "federation.clients=6" in said
    assert "at most 5" in said


def test_a_port_in_use_is_found_before_anything_starts(refused: Refused) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"federation.link.port={port}" in refused("train", f"federation.link.port={port}")


@pytest.mark.parametrize("kind", ["full folder", "file", "below a file"])
def test_a_run_folder_in_use_is_left_as_it_is(refused: Refused, tmp_path: Path, kind: str) -> None:
    folder = tmp_path / "run"
    if kind == "full folder":
        folder.mkdir()
        (folder / "notes.txt").write_text("mine")
    else:
        folder.write_text("mine")
    given = folder / "below" if kind == "below a file" else folder
    said = refused("train", "runtime=local", f"run.dir={given}")
    assert f"run.dir={given}" in said
    assert "allowed is a folder that" in said


# --- Showing the configuration --------------------------------------------------------------------


def test_cfg_prints_the_whole_configuration_as_yaml(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    overrides = ["env.robots=4", "strategy=fedprox", "runtime=local"]
    assert main(["train", "--cfg", *overrides]) == 0
    assert from_yaml(capsys.readouterr().out) == compose(overrides)
    assert list(tmp_path.iterdir()) == []


def test_cfg_finds_mistakes_too(refused: Refused) -> None:
    refused("train", "--cfg", "env.robots=0")


# --- Evaluating a run -----------------------------------------------------------------------------


def test_evaluate_prints_a_table_and_writes_json(
    tiny_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.stat().st_mtime_ns for path in tiny_run.rglob("*")}
    out = tmp_path / "measures.json"
    options = ["--episodes", "3", "--epsilon", "0", "--epsilon", "0.2", "--json", str(out)]
    assert main(["evaluate", str(tiny_run), *options]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    for word in ("3 held-out episodes", "success", "eps = 0.2", "SIC violations"):
        assert word in printed
    written = json.loads(out.read_text())
    assert list(written) == ["eps = 0", "eps = 0.2"]
    assert all(set(MEASURES) <= set(measures) for measures in written.values())
    assert {path: path.stat().st_mtime_ns for path in tiny_run.rglob("*")} == before


def test_evaluate_gives_what_the_summary_says(tiny_run: Path, tmp_path: Path) -> None:
    out = tmp_path / "measures.json"
    assert main(["evaluate", str(tiny_run), "--json", str(out)]) == 0
    written = json.loads(out.read_text())
    final = json.loads((tiny_run / "summary.json").read_text())["evaluation"]
    for name in MEASURES:
        assert written["eps = 0"][name] == final["greedy"][name]
        if name != "path_ratio":
            assert written["eps = 0.05"][name] == final["eps05"][name]


@pytest.fixture
def copied(tiny_run: Path, tmp_path: Path) -> Path:
    """A run that a test may spoil."""
    folder = tmp_path / "copied"
    folder.mkdir()
    for name in ("config.yaml", "weights.safetensors", "progress.json"):
        shutil.copy(tiny_run / name, folder)
    return folder


def test_evaluate_refuses_a_folder_that_is_no_run(refused: Refused, tmp_path: Path) -> None:
    assert "is no run folder" in refused("evaluate", str(tmp_path / "nothing"))


@pytest.mark.parametrize("text", ["a: [", "seed: nine\n", "nonsense: 1\n", "\x00\x01"])
def test_evaluate_refuses_a_damaged_configuration(
    refused: Refused, copied: Path, text: str
) -> None:
    (copied / "config.yaml").write_text(text)
    refused("evaluate", str(copied))


def test_evaluate_refuses_a_configuration_that_is_no_text(refused: Refused, copied: Path) -> None:
    (copied / "config.yaml").write_bytes(b"\xff\xfe\xfa")
    refused("evaluate", str(copied))


def test_evaluate_reads_a_configuration_that_another_editor_saved(copied: Path) -> None:
    config = RunFolder(copied).read_config()
    text = (copied / "config.yaml").read_text(encoding="utf-8")
    (copied / "config.yaml").write_bytes(text.replace("\n", "\r\n").encode("utf-8-sig"))
    assert RunFolder(copied).read_config() == config


def test_evaluate_says_that_a_configuration_is_in_utf_16(refused: Refused, copied: Path) -> None:
    text = (copied / "config.yaml").read_text(encoding="utf-8")
    (copied / "config.yaml").write_text(text, encoding="utf-16")
    said = refused("evaluate", str(copied))
    assert "config.yaml cannot be read: it is in UTF-16: save it as UTF-8." in said


def test_evaluate_refuses_missing_weights(refused: Refused, copied: Path) -> None:
    (copied / "weights.safetensors").unlink()
    assert "weights.safetensors is missing: has the run ended?" in refused("evaluate", str(copied))


@pytest.mark.parametrize("keep", [0, 20, 500])
def test_evaluate_refuses_weights_that_are_cut_short(
    refused: Refused, copied: Path, keep: int
) -> None:
    path = copied / "weights.safetensors"
    path.write_bytes(path.read_bytes()[:keep])
    assert "is damaged" in refused("evaluate", str(copied))


def test_evaluate_refuses_weights_of_another_size(refused: Refused, copied: Path) -> None:
    text = (copied / "config.yaml").read_text()
    assert "  - 13\n" in text
    (copied / "config.yaml").write_text(text.replace("  - 13\n", "  - 14\n"))
    assert "where config.yaml says (3, 2, " in refused("evaluate", str(copied))


def test_evaluate_refuses_a_place_for_json_that_is_not_there(
    refused: Refused, copied: Path, tmp_path: Path
) -> None:
    for place in (tmp_path / "missing" / "a.json", tmp_path):
        said = refused("evaluate", str(copied), "--json", str(place))
        assert f"--json {place}: allowed is a file" in said


def test_evaluate_refuses_a_folder_in_place_of_weights(refused: Refused, copied: Path) -> None:
    (copied / "weights.safetensors").unlink()
    (copied / "weights.safetensors").mkdir()
    assert "weights.safetensors" in refused("evaluate", str(copied))


def test_another_seed_plays_other_starts(tiny_run: Path, tmp_path: Path) -> None:
    written = []
    for seed in ("0", "0", "5"):
        out = tmp_path / "measures.json"
        assert main(["evaluate", str(tiny_run), "--seed", seed, "--json", str(out)]) == 0
        written.append(json.loads(out.read_text()))
    assert written[0] == written[1] != written[2]


@pytest.mark.parametrize(
    "options",
    [["--episodes", "0"], ["--epsilon", "2"], ["--episodes", "many"], ["--seed", "-1"], ["--no"]],
)
def test_evaluate_refuses_options_out_of_range(
    copied: Path, options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["evaluate", str(copied), *options])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert " _" not in said
    assert options[0] in said


# --- Looking at a run -----------------------------------------------------------------------------


def test_status_shows_where_a_run_is(tiny_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", str(tiny_run)]) == 0
    printed = capsys.readouterr().out
    assert "done" in printed
    assert "tick" in printed
    assert "100" in printed


def test_status_shows_why_a_run_failed(copied: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status = json.loads((copied / "progress.json").read_text())
    status |= {"state": "failed", "message": "RobotLost: robot 2 lost"}
    (copied / "progress.json").write_text(json.dumps(status))
    assert main(["status", str(copied)]) == 0
    printed = capsys.readouterr().out
    assert "failed" in printed
    assert "robot 2 lost" in printed


def test_status_of_a_folder_without_a_run_is_one_sentence(refused: Refused, tmp_path: Path) -> None:
    assert "holds no run" in refused("status", str(tmp_path))
    refused("status")


@pytest.mark.parametrize("text", ["", "{", "[]", "7"])
def test_status_of_a_damaged_run_is_one_sentence(refused: Refused, copied: Path, text: str) -> None:
    (copied / "progress.json").write_text(text)
    refused("status", str(copied))


def test_status_of_a_run_that_says_nothing_is_unknown(
    copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (copied / "progress.json").write_text("{}")
    assert main(["status", str(copied)]) == 0
    assert "unknown" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("state", "silence_s", "shown"),
    [("training", 60, True), ("starting", 60, True), ("training", 0, False), ("done", 60, False)],
)
def test_status_says_when_a_run_was_last_heard(
    copied: Path, capsys: pytest.CaptureFixture[str], state: str, silence_s: float, shown: bool
) -> None:
    status = json.loads((copied / "progress.json").read_text())
    status |= {"state": state, "written_at": time.time() - silence_s}
    (copied / "progress.json").write_text(json.dumps(status))
    assert main(["status", str(copied)]) == 0
    assert ("last heard" in capsys.readouterr().out) == shown
