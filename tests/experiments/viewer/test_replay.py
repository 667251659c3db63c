"""``risfleet replay``: pages that need nothing else, films, and what may stand beside a run."""

from __future__ import annotations

import base64
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from experiments.cli import main
from experiments.viewer import replays
from experiments.viewer.film import frames
from experiments.viewer.page import page
from experiments.viewer.scene import NO_WAY
from training.run_folder import RunFolder

Saying = Callable[..., str]


def data_of(html: str) -> dict[str, Any]:
    found = re.search(r'<script id="data" type="application/json">(.*?)</script>', html, re.DOTALL)
    assert found is not None
    data: dict[str, Any] = json.loads(found[1])
    return data


def test_a_page_holds_the_episode_and_what_it_stands_against(
    tiny_run: Path, tmp_path: Path
) -> None:
    out = tmp_path / "replay.html"
    against = ["--against", "oracle", "--against", "shortest", "--against", str(tiny_run)]
    assert main(["replay", str(tiny_run), "--out", str(out), *against]) == 0
    html = out.read_text(encoding="utf-8")
    assert len(html) < 1_000_000
    panels = data_of(html)["panels"]
    assert [panel["title"].split(":")[0] for panel in panels] == [
        tiny_run.name, "trajectory oracle", "shortest ways, best phases and powers", tiny_run.name,
    ]  # fmt: skip
    starts = [panel["episode"]["cells"][0] for panel in panels]
    assert all(start == starts[0] for start in starts)
    assert panels[0]["episode"] == panels[3]["episode"]
    assert panels[1]["episode"]["ee"] >= panels[2]["episode"]["ee"]


def test_another_run_drives_from_the_same_start_or_is_refused(
    refused: Saying, tiny_run: Path, trained: Callable[..., Path], tmp_path: Path
) -> None:
    out = tmp_path / "replay.html"
    other = trained({"seed": 5})
    assert main(["replay", str(tiny_run), "--out", str(out), "--against", str(other)]) == 0
    one, its = data_of(out.read_text(encoding="utf-8"))["panels"]
    assert one["episode"]["cells"][0] == its["episode"]["cells"][0]
    elsewhere = trained({"env.tasks.destinations_m": [[6.5, 2.5], [1.5, 1.5], [5.5, 5.5]]})
    said = refused("replay", tiny_run, "--out", out, "--against", elsewhere)
    assert "whose robots have the same destinations" in said


def test_a_page_has_no_address_outside_itself(tiny_run: Path) -> None:
    html = page("x", {"panels": [replays.of_run(RunFolder(tiny_run), 0)]})
    addresses = set(re.findall(r"[a-z]+://[^\"'\s)]+", html))
    assert addresses == {"http://www.w3.org/2000/svg"}  # a name, not a place
    assert not re.search(r"<(link|script|img|iframe)[^>]+(src|href)=[\"'](?!data:)", html)


def test_what_is_shown_cannot_end_the_data(tiny_run: Path) -> None:
    panel = replays.of_run(RunFolder(tiny_run), 0) | {"title": "</script><b>@STYLE@ & <!--"}
    html = page("<i> & @DATA@", {"panels": [panel]})
    assert data_of(html)["panels"][0]["title"] == panel["title"]
    assert "<title>&lt;i&gt; &amp; @DATA@</title>" in html


def test_another_start_is_another_episode_and_exploring_another_way(tiny_run: Path) -> None:
    folder = RunFolder(tiny_run)
    first, other, random = (
        replays.of_run(folder, *which)["episode"]["cells"] for which in ((0,), (1,), (0, 1.0))
    )
    assert first[0] != other[0]
    assert first[0] == random[0]
    assert first != random


def test_cells_that_no_robot_reaches_have_no_shade(
    tmp_path: Path, trained: Callable[..., Path]
) -> None:
    run = trained({
        "env.walls.segments": [[2.0, 0.0, 2.0, 2.0], [0.0, 2.0, 2.0, 2.0]],
        "env.walls.block_motion": True,
        "env.tasks.destinations_m": [[7.5, 2.5], [4.5, 1.5], [5.5, 5.5]],
    })  # fmt: skip
    scene = replays.of_run(RunFolder(run), 0)["scene"]
    shades = np.frombuffer(base64.b64decode(scene["map"]), np.uint8)
    shut = shades.reshape(scene["rows"], scene["columns"]) == NO_WAY
    assert shut.sum() == 4
    assert shut[:2, :2].all()


def test_a_gif_plays_every_slot_and_rests_at_the_end(tiny_run: Path, tmp_path: Path) -> None:
    out = tmp_path / "replay.gif"
    assert main(["replay", str(tiny_run), "--out", str(out), "--frames", "1"]) == 0
    slots = replays.of_run(RunFolder(tiny_run), 0)["episode"]["slots"]
    with Image.open(out) as film:
        assert film.n_frames == slots + 1  # type: ignore[attr-defined]
        assert film.info["loop"] == 0
        pauses = []
        for frame in range(film.n_frames):  # type: ignore[attr-defined]
            film.seek(frame)
            pauses.append(film.info["duration"])
    assert pauses[-1] > 5 * pauses[0]


def test_an_mp4_is_one(tiny_run: Path, tmp_path: Path) -> None:
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    out = tmp_path / "replay.mp4"
    assert main(["replay", str(tiny_run), "--out", str(out), "--frames", "1"]) == 0
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(out))
    slots = replays.of_run(RunFolder(tiny_run), 0)["episode"]["slots"]
    assert count == slots + 1 + 12
    assert seconds == pytest.approx(count / 8, abs=0.2)


def test_pictures_of_a_film_show_robots_moving(tiny_run: Path) -> None:
    pictures = [*frames([replays.of_run(RunFolder(tiny_run), 0, 1.0)], 1)]
    assert all(picture.shape == pictures[0].shape for picture in pictures)
    assert any((picture != pictures[0]).any() for picture in pictures[1:])
    for colour in ((0, 114, 178), (230, 159, 0), (0, 158, 115)):
        assert (np.abs(pictures[0].astype(int) - colour).max(axis=-1) <= 2).sum() > 30


def test_without_its_package_an_mp4_is_refused_in_a_sentence(
    refused: Saying, tiny_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    out = tmp_path / "replay.mp4"
    assert "pip install 'risfleet[film]'" in refused("replay", tiny_run, "--out", out)
    assert not out.exists()


def test_mistakes_cost_a_sentence(
    refused: Saying, tiny_run: Path, building_run: Path, tmp_path: Path
) -> None:
    out = tmp_path / "replay.html"
    assert "allowed is a file that ends in one of .html, .gif, .mp4" in refused(
        "replay", tiny_run, "--out", tmp_path / "replay.avi"
    )
    assert "allowed is a file in a folder that exists" in refused(
        "replay", tiny_run, "--out", tmp_path / "nowhere" / "replay.html"
    )
    assert "is no run folder" in refused("replay", tmp_path, "--out", out)
    film = tmp_path / "replay.gif"
    assert "--frames 7: allowed is 1 to 6" in refused(
        "replay", tiny_run, "--out", film, "--frames", 7
    )
    assert "--episode 4: allowed is 0 to 3" in refused(
        "replay", tiny_run, "--out", out, "--episode", 4
    )
    assert f"{building_run / 'rooms' / '0000'}" in refused("replay", building_run, "--out", out)
    assert "nothing is no run folder" in refused(
        "replay", tiny_run, "--out", out, "--against", "nothing"
    )
    assert not out.exists()


def test_a_file_of_weights_is_as_good_as_its_folder(tiny_run: Path, tmp_path: Path) -> None:
    out = tmp_path / "replay.html"
    weights = tiny_run / "weights.safetensors"
    assert main(["replay", str(weights), "--out", str(out), "--against", str(weights)]) == 0
    one, its = data_of(out.read_text(encoding="utf-8"))["panels"]
    assert one["episode"] == its["episode"] == replays.of_run(RunFolder(tiny_run), 0)["episode"]


def test_a_room_of_a_building_is_replayed(building_run: Path, tmp_path: Path) -> None:
    out = tmp_path / "room.html"
    room = building_run / "rooms" / "held-out-0000"
    assert main(["replay", str(room), "--out", str(out)]) == 0
    assert len(data_of(out.read_text(encoding="utf-8"))["panels"]) == 1


def test_where_channels_change_in_each_slot_there_is_no_plan_to_stand_against(
    refused: Saying, tmp_path: Path, trained: Callable[..., Path]
) -> None:
    run = trained({"env.channel.fading": "slot"})
    said = refused("replay", run, "--out", tmp_path / "replay.html", "--against", "oracle")
    assert "env.channel.fading=slot" in said
