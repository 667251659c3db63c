"""What is kept in ``results/``: how it gets there, and that it is what the program computes."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reproduce_helpers import same_run, without_a_targets_own
from safetensors.numpy import load_file

from conf import fingerprint
from experiments.cli import main
from experiments.reproduce.export import collect, repeat
from experiments.reproduce.export.repeat import RegressionRun
from experiments.reproduce.targets import fig3, manifest
from experiments.reproduce.targets.plan import Cell
from experiments.runtimes import local
from storage.checkpoint_files import digest
from training.run_folder import RunFolder

ROOT = Path(__file__).parent.parent.parent.parent
RESULTS = ROOT / "results"
STORED = (RESULTS / repeat.FILE).exists()
KEPT = repeat.read(RESULTS) if STORED else []
TEXT = (".md", ".csv", ".json", ".yaml", ".svg")
FOLDERS = re.compile(r"(?<![\w.)])/(?:home|root|tmp|Users|mnt|var|opt|private|srv)/")
"""How a path of a machine begins."""

needs_results = pytest.mark.skipif(not STORED, reason="no results are kept in this checkout")


def check_again(kept: RegressionRun, folder: Path) -> None:
    """Trains the first ticks of a run again and compares the total rewards of its episodes.

    They are the same to the bit with the versions and the processor that computed them. Elsewhere
    the last digits of a network's values differ, which may change a robot's choice here and there
    (a learning rate that is 1e-7 larger changes none of them in 1,000 ticks, one that is a tenth
    larger changes the mean by .15 %): the first episode has to agree, and the mean to 2 %.
    """
    found = repeat.rerun(kept, folder).metrics()
    count = len(kept.rewards)
    assert count > 1
    if repeat.computed_by(fingerprint()) == kept.computed_by:
        assert found["tick"][:count].tolist() == kept.ticks.tolist()
        assert found["reward"][:count].tolist() == kept.rewards.tolist()
    else:
        assert found["reward"][0] == pytest.approx(kept.rewards[0], rel=1e-6)
        assert found["reward"][:count].mean() == pytest.approx(kept.rewards.mean(), rel=0.02)


def check_files(results: Path) -> None:
    """Every file of a manifest is there as it was, and nothing names a folder of a machine."""
    manifests = list(results.glob("*.manifest.json"))
    assert manifests
    for each in manifests:
        for name, expected in json.loads(each.read_text())["files"].items():
            if name != collect.SHARED:
                assert hashlib.sha256((results / name).read_bytes()).hexdigest() == expected
    for path in (path for path in results.rglob("*") if path.suffix in TEXT):
        text = path.read_text()
        assert not FOLDERS.search(text), path
        assert str(ROOT) not in text, path
    for weights in results.glob("weights/*/weights.safetensors"):
        arrays = load_file(weights)
        said = json.loads((weights.parent / "summary.json").read_text())["digest"]
        assert (digest(arrays["robots"]), digest(arrays["ap"])) == (said["robots"], said["ap"])


@pytest.fixture(scope="module")
def reproduced(
    tiny_run: Path, tiny_overrides: tuple[str, ...], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Fig. 3 as if the tiny run were that of each of its cells."""
    out: Path = tmp_path_factory.mktemp("reproduced")
    shutil.copytree(tiny_run, out / "runs" / "tiny")
    runs = same_run(fig3.TARGET, out / "runs" / "tiny")
    keys = tuple(without_a_targets_own(tiny_overrides))
    files = fig3.TARGET.report(runs, out, quick=True)
    cells = [Cell(name, keys, (0,)) for name in runs]
    manifest.write(out, "fig3", cells, runs, files, {"quick": True})
    return out


@pytest.fixture
def exported(reproduced: Path, tmp_path: Path) -> Path:
    results = tmp_path / "results"
    assert collect.main([str(reproduced), str(results)]) == 0
    return results


def test_an_export_holds_what_its_manifests_say(exported: Path, reproduced: Path) -> None:
    check_files(exported)
    assert (exported / "fig3.png").read_bytes() == (reproduced / "fig3.png").read_bytes()
    weights = {path.name for path in (exported / "weights").iterdir()}
    assert weights == {"k2", "k3", "k4", "README.md"}
    text = "".join(path.read_text() for path in exported.rglob("*") if path.suffix in TEXT)
    assert str(reproduced) not in text


def test_exported_weights_can_be_evaluated(
    exported: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    capsys.readouterr()
    json_file = tmp_path / "measures.json"
    folder = exported / "weights" / "k3"
    assert main(["evaluate", str(folder), "--episodes", "2", "--json", str(json_file)]) == 0
    assert set(json.loads(json_file.read_text())) == {"eps = 0", "eps = 0.05"}
    assert "held-out" in capsys.readouterr().out


def test_the_card_has_a_row_for_all_weights(exported: Path) -> None:
    card = (exported / "weights" / "README.md").read_text()
    for name in ("k2", "k3", "k4"):
        assert card.count(f"| {name} | ") == 3  # what it is, how well it plays, its layers
    assert "evaluate results/weights/k2" in card
    assert "robots, which pick their moves and powers, and of the" in card
    assert "{" not in card


def test_kept_episodes_are_those_of_the_same_run_again(
    exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(repeat, "TICKS", 100)
    (kept,) = repeat.read(exported)
    assert (kept.target, kept.cell, kept.seed) == ("fig3", "F-DRL, K = 2", 0)
    assert len(kept.rewards) == 4
    check_again(kept, tmp_path / "again")
    other = RegressionRun(**{**vars(kept), "rewards": kept.rewards + np.array([0, 0, 0, 1e-9])})
    with pytest.raises(AssertionError):
        check_again(other, tmp_path / "other")


def test_other_runs_can_be_kept_under_a_name(
    reproduced: Path, tiny_run: Path, tmp_path: Path
) -> None:
    named = f"k3-best={tiny_run}"
    assert collect.main([str(reproduced), str(tmp_path), "--weights", named]) == 0
    kept, run = (
        folder / "weights.safetensors" for folder in (tmp_path / "weights/k3-best", tiny_run)
    )
    assert kept.read_bytes() == run.read_bytes()
    check_files(tmp_path)


def test_what_cannot_be_exported_is_said_in_a_sentence(
    reproduced: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert collect.main([str(tmp_path), str(tmp_path / "results")]) == 2
    assert "no manifest of a target is there" in capsys.readouterr().err
    assert collect.main([str(reproduced), str(tmp_path / "results"), "--weights", "k3"]) == 2
    assert "allowed is NAME=RUN" in capsys.readouterr().err
    changed = tmp_path / "changed"
    shutil.copytree(reproduced, changed, ignore=shutil.ignore_patterns("runs"))
    (changed / "fig3.csv").write_text("other\n")
    assert collect.main([str(changed), str(tmp_path / "results")]) == 2
    assert "changed after its manifest was written" in capsys.readouterr().err


def test_the_card_says_who_picks_the_powers(reproduced: Path, tiny: Any, tmp_path: Path) -> None:
    run = tmp_path / "run"
    changes = {"run.dir": str(run), "scheme.power": "search", "evaluation.every": 1000}
    changes |= {"train.max_ticks": 40}
    local.train(tiny(changes), RunFolder(run))
    results = tmp_path / "results"
    assert collect.main([str(reproduced), str(results), "--weights", f"k3-best={run}"]) == 0
    card = (results / "weights" / "README.md").read_text()
    assert "robots, which pick their moves, and of the access" in card
    picks = " ".join(card.split())
    assert "by the robots themselves (k2, k3, k4), or by the access point" in picks
    assert "(k3-best)." in picks
    success = json.loads((run / "summary.json").read_text())["evaluation"]["eps05"]["success"]
    assert f"| k3-best | 1 | {success:.2f} (" in card  # fewer than five evaluations: the final one
    assert main(["evaluate", str(results / "weights" / "k3-best"), "--episodes", "2"]) == 0


@needs_results
def test_stored_results_are_whole() -> None:
    check_files(RESULTS)
    targets = {path.name.split(".")[0] for path in RESULTS.glob("*.manifest.json")}
    assert {kept.target for kept in KEPT} == targets - {"claims"}


@needs_results
@pytest.mark.parametrize(
    "kept",
    [
        pytest.param(
            each,
            id=each.target,
            marks=[] if each.target in ("fig3", "gossip") else [pytest.mark.slow],
        )
        for each in KEPT
    ],
)
def test_stored_runs_begin_as_they_do_now(kept: RegressionRun, tmp_path: Path) -> None:
    check_again(kept, tmp_path / "run")


@needs_results
def test_stored_weights_can_be_evaluated() -> None:
    folders = [path.parent for path in RESULTS.glob("weights/*/config.yaml")]
    assert folders
    for folder in folders:
        assert main(["evaluate", str(folder), "--episodes", "1"]) == 0


@needs_results
def test_tables_in_the_documents_are_those_of_the_results() -> None:
    """A table whose header is that of one in ``results/`` has its rows, too."""
    text = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md"))
    for path in RESULTS.glob("*.md"):
        table = [line for line in path.read_text().splitlines() if line.startswith("|")]
        if table[0] in text:
            assert "\n".join(table) in text, path.name
