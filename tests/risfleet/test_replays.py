"""Episodes from Python: in a notebook's cell, as pages and films."""

from __future__ import annotations

from pathlib import Path

import pytest

import risfleet
from experiments.cli import main


def test_a_replay_is_the_page_of_the_command(tiny_run: Path, tmp_path: Path) -> None:
    by_command = tmp_path / "command.html"
    assert main(["replay", str(tiny_run), "--out", str(by_command), "--against", "oracle"]) == 0
    replay = risfleet.load(tiny_run).replay(against="oracle")
    saved = replay.save(tmp_path / "python.html")
    assert saved.read_text(encoding="utf-8") == replay.html
    assert [panel["title"] for panel in replay.panels][1].startswith("trajectory oracle")
    title = f"RISFleet: {tiny_run}"
    same = by_command.read_text(encoding="utf-8").replace(title, replay.title)
    assert same == replay.html


def test_a_cell_shows_it_in_a_frame_that_its_content_cannot_leave(tiny_run: Path) -> None:
    html = risfleet.load(tiny_run).replay()._repr_html_()
    assert html.startswith("<iframe ")
    assert 'sandbox="allow-scripts"' in html
    assert html.count("<") == 2  # the frame's own tags: all else is escaped
    assert html.endswith('"></iframe>')


def test_mistakes_are_errors_in_the_commands_words(tiny_run: Path, tmp_path: Path) -> None:
    run = risfleet.load(tiny_run)
    with pytest.raises(risfleet.ConfigError, match="--episode 4: allowed is 0 to 3"):
        run.replay(episode=4)
    with pytest.raises(risfleet.ConfigError, match="epsilon"):
        run.replay(epsilon=2.0)
    with pytest.raises(risfleet.ConfigError, match="no run folder"):
        run.replay(against=["nothing"])
    with pytest.raises(risfleet.ConfigError, match=r"one of \.html, \.gif, \.mp4"):
        run.replay().save(tmp_path / "replay.txt")
