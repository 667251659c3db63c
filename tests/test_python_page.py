"""Every snippet of docs/python.md runs, in its order."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import risfleet

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "python.md"
SHORT = ["runtime=local", "train.episodes=2", "evaluation.episodes=2", "agent.learn_from=10000"]
SHORT += ["run.figures=false", "run.tensorboard=false"]


def test_the_snippets_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs are cut short; all else is as it stands."""
    from conf.python_values import override_texts

    whole = risfleet.train

    def train(overrides: Any, **options: Any) -> risfleet.Run:
        return whole([*override_texts(overrides), *SHORT], **options)

    (tmp_path / "results").symlink_to(ROOT / "results")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(risfleet, "train", train)
    snippets = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.M | re.S)
    assert len(snippets) >= 7
    names: dict[str, Any] = {}
    for snippet in snippets:
        exec(compile(snippet, str(PAGE), "exec"), names)
    assert names["actions"].shape == (1, 4)
    assert names["rule"].success == 1.0
