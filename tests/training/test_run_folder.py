"""The folder of a run: one class knows its files, and says what is there."""

import ast
from pathlib import Path

import pytest

from training.run_folder import RunFolder

ROOT = Path(__file__).parent.parent.parent
PACKAGES = (
    "env", "storage", "repeatable", "agent", "lockstep", "conf", "training", "client_app",
    "server_app", "experiments",
)  # fmt: skip
OWNER = ROOT / "training" / "run_folder.py"
FILES = (
    "config.yaml", "summary.json", "progress.json", "metrics.csv", "evaluations.csv",
    "episode.json", "weights.safetensors", "flower.log", "rooms.json", "rooms.csv",
)  # fmt: skip
PLAIN = ("stop", "state", "figures", "tensorboard", "wandb", "mlflow")
"""Names that are words, too: these are names only where a path is made of them."""


def test_the_files_of_a_run_are_called_as_they_always_were() -> None:
    found = RunFolder(Path("run"))
    paths = [path for name, path in vars(found).items() if name != "path"]
    assert {path.name for path in paths} == {*FILES, *PLAIN}
    assert {path.parent for path in paths} == {Path("run")}


def test_a_run_has_begun_once_its_folder_holds_more_than_a_start_leaves(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run")
    assert not folder.has_begun
    folder.path.mkdir()
    assert not folder.has_begun
    folder.progress_file.touch()
    folder.stop_file.touch()
    assert not folder.has_begun
    folder.config_file.touch()
    assert folder.has_begun


def test_a_run_has_ended_once_summary_and_weights_are_there(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    folder.summary_file.touch()
    assert not folder.has_ended
    folder.weights_file.touch()
    assert folder.has_ended


def test_a_building_has_ended_once_its_summary_is_there(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    folder.rooms_file.touch()
    assert not folder.has_ended
    folder.summary_file.touch()
    assert folder.has_ended


@pytest.mark.parametrize("whole", [False, True])
def test_a_run_that_goes_on_keeps_its_records_and_one_that_begins_again_does_not(
    tmp_path: Path, whole: bool
) -> None:
    folder = RunFolder(tmp_path)
    for path in (folder.progress_file, folder.summary_file, folder.metrics_file, folder.stop_file):
        path.touch()
    tracked = {folder.tensorboard, folder.wandb, folder.mlflow}
    for path in tracked:
        path.mkdir()
    folder.clear(whole=whole)
    kept = {folder.stop_file} if whole else {folder.stop_file, folder.metrics_file, *tracked}
    assert {*tmp_path.iterdir()} == kept


def test_a_first_failure_stands(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run")
    assert folder.failure is None
    folder.report_state("waiting", "for robot 1")
    assert folder.failure is None
    folder.report_failure(ValueError("first"))
    folder.report_failure(ValueError("second"))
    folder.report_state("waiting", "for robot 1")
    assert folder.failure == "ValueError: first"


def spelt(source: str) -> list[str]:
    """The names of a run's files that a module spells outside its descriptions."""
    tree = ast.parse(source)
    described = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    parts = {
        id(part)
        for node in ast.walk(tree)
        for part in (
            (node.right,) if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div)
            else (node.value,) if isinstance(node, ast.Assign)
            else ()
        )
    }  # fmt: skip
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) not in described:
                found += [name for name in FILES if name in node.value]
            if id(node) in parts and node.value in PLAIN:
                found.append(node.value)
    return found


def test_no_other_module_spells_the_name_of_a_run_s_file() -> None:
    modules = (path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py")))
    found = {
        str(path.relative_to(ROOT)): names
        for path in modules
        if path != OWNER and (names := spelt(path.read_text()))
    }
    assert found == {}


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ('path = folder / "summary.json"', ["summary.json"]),
        ('say = f"{folder}: config.yaml cannot be read"', ["config.yaml"]),
        ('state = folder / "state"', ["state"]),
        ('STOP = "stop"', ["stop"]),
        ('status["state"] == "stop"', []),
        ('"""Writes ``summary.json``."""', []),
    ],
)
def test_this_rule_catches_what_it_should(source: str, found: list[str]) -> None:
    assert spelt(source) == found
