"""Cards of weights have the front matter that Hugging Face's hub reads, from the results' files."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml  # type: ignore[import-untyped]

from experiments.reproduce.export import hub
from storage.safetensors_metadata import read_metadata
from training.run_folder import RunFolder
from training.weights_metadata import config_in

WEIGHTS = Path(__file__).parents[3] / "results" / "weights"
STORED = sorted(path.parent for path in WEIGHTS.glob("*/weights.safetensors"))

needs_weights = pytest.mark.skipif(not STORED, reason="no weights are kept in this checkout")


def front_matter(card: Path) -> dict[str, Any]:
    _, front, body = card.read_text(encoding="utf-8").split("---\n", 2)
    assert body.startswith("\n# ")
    found: dict[str, Any] = yaml.safe_load(front)
    return found


def measured(folder: Path) -> dict[str, float]:
    """The values of a folder's summary by their names in a card."""
    evaluation = json.loads((folder / "summary.json").read_text())["evaluation"]
    return {
        f"{name}, {how}": evaluation[kind][measure]
        for kind, how in hub.PLAYED.items()
        for measure, name in hub.MEASURES.items()
        if evaluation[kind][measure] is not None
    }


def values(result: dict[str, Any]) -> dict[str, float]:
    return {metric["name"]: metric["value"] for metric in result["metrics"]}


@pytest.fixture
def weights(tiny_run: Path, tmp_path: Path) -> Path:
    """A folder of weights that do not describe themselves yet, with a card of all."""
    folder = tmp_path / "weights"
    (folder / "tiny").mkdir(parents=True)
    for name in ("config.yaml", "summary.json", "weights.safetensors"):
        shutil.copyfile(tiny_run / name, folder / "tiny" / name)
    (folder / "README.md").write_text("# Weights\n\nAll of them.\n")
    return folder


@needs_weights
def test_stored_cards_are_what_the_command_writes(tmp_path: Path) -> None:
    again = tmp_path / "weights"
    shutil.copytree(WEIGHTS, again)
    hub.dress(again)
    for folder in (WEIGHTS, *STORED):
        card = folder.relative_to(WEIGHTS) / "README.md"
        assert (again / card).read_bytes() == (WEIGHTS / card).read_bytes(), card


@needs_weights
def test_stored_cards_hold_the_measures_of_their_summaries() -> None:
    (index,) = front_matter(WEIGHTS / "README.md")["model-index"]
    by_name = {result["dataset"]["config"]: values(result) for result in index["results"]}
    assert by_name == {folder.name: measured(folder) for folder in STORED}
    for folder in STORED:
        found = front_matter(folder / "README.md")
        ((result,),) = ([*each["results"]] for each in found["model-index"])
        assert values(result) == measured(folder)
        assert (found["license"], found["pipeline_tag"]) == ("apache-2.0", "reinforcement-learning")
        config = config_in(read_metadata(folder / "weights.safetensors"))
        assert config is not None
        assert config.env == RunFolder(folder).read_config().env


@needs_weights
@pytest.mark.parametrize("card", [WEIGHTS, *STORED], ids=lambda folder: folder.name)
def test_the_hub_s_own_parser_reads_stored_cards(card: Path) -> None:
    huggingface_hub = pytest.importorskip("huggingface_hub")
    found = huggingface_hub.ModelCard.load(card / "README.md").data
    assert (found.license, found.library_name) == ("apache-2.0", "risfleet")
    folders = STORED if card == WEIGHTS else [card]
    read = {
        (result.dataset_config, result.metric_name): result.metric_value
        for result in found.eval_results
    }
    assert read == {
        (folder.name, name): value for folder in folders for name, value in measured(folder).items()
    }
    assert {result.task_type for result in found.eval_results} == {"reinforcement-learning"}


def test_a_card_that_has_front_matter_gets_it_anew(weights: Path) -> None:
    hub.dress(weights)
    once = (weights / "README.md").read_text()
    assert once.count("model-index:") == 1
    assert once.endswith("---\n\n# Weights\n\nAll of them.\n")
    hub.dress(weights)
    assert (weights / "README.md").read_text() == once


def test_weights_that_are_not_those_of_their_summary_are_refused(
    weights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = json.loads((weights / "tiny" / "summary.json").read_text())
    summary["digest"]["ap"] = "0" * 64
    (weights / "tiny" / "summary.json").write_text(json.dumps(summary))
    assert hub.main([str(weights)]) == 2
    assert "weights.safetensors: they are not those of summary.json." in capsys.readouterr().err
    assert not (weights / "tiny" / "README.md").exists()


def test_a_folder_without_weights_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hub.main([str(tmp_path)]) == 2
    assert "allowed is a folder with folders of weights." in capsys.readouterr().err
