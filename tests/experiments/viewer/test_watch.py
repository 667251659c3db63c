"""``risfleet watch``: what the page of a run is told, to whom, and that it changes nothing."""

from __future__ import annotations

import csv
import hashlib
import json
import shutil
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from experiments.cli import main
from experiments.viewer.follower import POINTS, Follower
from experiments.viewer.server import WatchServer
from training.run_folder import RunFolder

Watched = Callable[..., Any]


def told(run: Path) -> dict[str, Any]:
    """The events of a run's page, by name."""
    return {name: json.loads(data) for name, data in Follower(RunFolder(run)).events()}


def get(server: WatchServer, path: str, **headers: str) -> tuple[int, str, str]:
    """Status, content type and text of an answer."""
    connection = HTTPConnection(*server.server_address[:2], timeout=20)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, answer.headers.get_content_type(), text


def news(server: WatchServer) -> Iterator[tuple[str, str]]:
    """A page's stream, event by event."""
    with urllib.request.urlopen(f"{server.url}events", timeout=20) as stream:
        assert stream.headers.get_content_type() == "text/event-stream"
        name = ""
        for line in stream:
            field, _, value = line.decode().rstrip("\n").partition(": ")
            if field == "event":
                name = value
            elif field == "data":
                yield name, value


def contents(folder: Path) -> dict[str, str]:
    return {
        str(path): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture
def copied(tiny_run: Path, tmp_path: Path) -> Path:
    """A copy of a finished run, to write to."""
    return Path(shutil.copytree(tiny_run, tmp_path / "copy"))


def test_a_page_is_told_state_curves_and_the_newest_episode(tiny_run: Path) -> None:
    found = told(tiny_run)
    assert found["status"]["said"] == "done."
    assert ["tick", "100"] in found["status"]["figures"]
    rows = [*csv.DictReader((tiny_run / "metrics.csv").open())]
    assert found["curves"]["train"]["reward"] == [float(row["reward"]) for row in rows]
    evaluations = [*csv.DictReader((tiny_run / "evaluations.csv").open())]
    for kind, epsilon in (("explored", 0.05), ("greedy", 0.0)):
        own = [float(row["ee"]) for row in evaluations if float(row["epsilon"]) == epsilon]
        assert found["curves"][kind]["ee"] == own
    panel = found["panel"]
    assert panel["episode"] == RunFolder(tiny_run).read_episode()
    assert panel["scene"]["rows"] * panel["scene"]["columns"] == 48
    assert "tick 100" in panel["title"]


def test_the_stream_sends_everything_once_and_then_what_changes(
    copied: Path, watched: Watched
) -> None:
    with watched(copied) as server:
        for stream in (news(server), news(server)):  # each page is sent all of it
            assert [next(stream)[0] for _ in range(3)] == ["status", "curves", "panel"]
        RunFolder(copied).report_state("failed", "for a test")
        name, data = next(stream)
        assert (name, json.loads(data)["said"]) == ("status", "failed. for a test")


def test_watching_changes_nothing_in_the_folder(
    copied: Path, building_run: Path, watched: Watched
) -> None:
    for run in (copied, building_run):
        before = contents(run)
        with watched(run) as server:
            assert len([*islice(news(server), 3)]) == 3
            get(server, "/")
            get(server, "/room/0000")
        assert contents(run) == before


def test_a_building_is_told_as_rooms_each_on_request(building_run: Path, watched: Watched) -> None:
    rooms = told(building_run)["rooms"]
    assert [room["name"] for room in rooms] == ["0000", "0001", "0002", "held-out-0000"]
    assert all("arrive, EE" in room["said"] for room in rooms)
    with watched(building_run) as server:
        status, kind, text = get(server, "/room/held-out-0000")
        assert (status, kind) == (200, "application/json")
        episode = RunFolder(building_run).room("held-out-0000").read_episode()
        assert json.loads(text)["episode"] == episode
        for path in ("/room/0009", "/room/..%2f..%2fetc%2fpasswd", "/room/"):
            assert get(server, path)[0] == 404


def test_curves_of_rooms_go_forward_in_time(building_run: Path) -> None:
    for curve in ("train", "explored", "greedy"):
        at = told(building_run)["curves"][curve]["at"]
        assert at == sorted(at)


def test_the_page_is_for_this_machine_alone(tiny_run: Path, watched: Watched) -> None:
    with watched(tiny_run) as server:
        host, port = server.server_address[:2]
        assert host == "127.0.0.1"
        status, kind, text = get(server, "/")
        assert (status, kind) == (200, "text/html")
        assert "<!doctype html>" in text
        assert get(server, "/", Host=f"localhost:{port}")[0] == 200
        assert get(server, "/", Host="risfleet.example")[0] == 403
        assert get(server, "/events", Host=f"risfleet.example:{port}")[0] == 403
        assert get(server, "/config.yaml")[0] == 404
        request = urllib.request.Request(server.url, data=b"x", method="POST")
        with pytest.raises(urllib.error.HTTPError, match="501"):
            urllib.request.urlopen(request, timeout=20)


def test_a_row_that_is_being_written_is_left_for_later(copied: Path) -> None:
    before = told(copied)["curves"]["train"]
    with (copied / "metrics.csv").open("a") as file:
        file.write("99,990,2")
    assert told(copied)["curves"]["train"] == before


def test_a_run_that_has_only_just_begun_has_a_page(copied: Path) -> None:
    for name in ("progress.json", "episode.json", "metrics.csv", "evaluations.csv"):
        (copied / name).unlink()
    found = told(copied)
    assert found["status"]["said"] == "not begun"
    assert found["panel"] is None
    assert found["curves"]["train"] == {"at": []}


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("episode.json", "{}", "done. KeyError"),
        ("metrics.csv", "episode,tick\n1,x\n", "done. ValueError"),
        ("progress.json", '{"clients": null}', "cannot be shown: TypeError"),
    ],
)
def test_what_is_damaged_is_said_and_the_rest_is_shown(
    copied: Path, name: str, text: str, said: str
) -> None:
    (copied / name).write_text(text)
    found = told(copied)
    assert said in found["status"]["said"]
    assert len(found) == (3 if name == "progress.json" else 2)


def test_a_silent_run_is_said_to_be_silent(copied: Path) -> None:
    folder = RunFolder(copied)
    progress = folder.read_progress()
    assert progress is not None
    folder.write_progress({**progress, "state": "training", "written_at": 1.0})
    assert "training, silent for" in told(copied)["status"]["said"]


def test_clients_their_losses_and_rounds_are_told(copied: Path) -> None:
    folder = RunFolder(copied)
    robots = {"robots": [0, 1], "connected": True, "bytes_sent": 2e6, "bytes_received": 1e6}
    rooms = {"rooms": [*range(9)], "connected": False, "missed": "node is gone"}
    clients = [{**robots, "flower_bytes": 0}, {**rooms, "flower_bytes": 5e5}]
    progress = folder.read_progress()
    assert progress is not None
    folder.write_progress({**progress, "clients": clients, "losses": 2, "round": 7})
    status = told(copied)["status"]
    assert ["clients lost and awaited", "2"] in status["figures"]
    assert ["round", "7"] in status["figures"]
    assert status["clients"] == [
        ["robots 0, 1", "connected", "3.0 MB"],
        ["rooms 0, 1, 2, 3, 4, 5, 6, 7, ...", "not connected, missed the last round: node is gone",
         "0.5 MB"],
    ]  # fmt: skip


def test_long_curves_are_thinned_to_means(copied: Path) -> None:
    rows = (copied / "metrics.csv").read_text().splitlines()
    columns = rows[0].split(",")
    count = 3 * POINTS + 5
    text = [rows[0]]
    for i in range(count):
        values = dict.fromkeys(columns, 0.0) | {"episode": i, "reward": float(i)}
        text.append(",".join(str(values[name]) for name in columns))
    (copied / "metrics.csv").write_text("\n".join(text) + "\n")
    train = told(copied)["curves"]["train"]
    assert len(train["at"]) <= POINTS
    assert train["at"][-1] == count - 1
    assert train["reward"][0] == pytest.approx((0 + 1 + 2 + 3) / 4)


def test_a_port_that_is_taken_is_named_in_a_sentence(
    tiny_run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["watch", str(tiny_run), "--port", str(port)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"risfleet: --port {port}: allowed is one that is free on 127.0.0.1")
    assert said.count("\n") == 1


def test_what_is_no_run_is_refused_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["watch", str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith(f"risfleet: {tmp_path} is no run folder")


def default_interrupt() -> None:
    """Ctrl-C as in a terminal; whoever runs tests in the background ignores it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.slow
def test_ctrl_c_ends_it(tiny_run: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "experiments.cli", "watch", str(tiny_run)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=default_interrupt,
    )
    try:
        assert process.stdout is not None
        url = process.stdout.readline().decode().split()[1]
        with urllib.request.urlopen(url, timeout=20) as answer:
            assert answer.status == 200
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
        assert (process.returncode, errors) == (0, b"")
    finally:
        process.kill()
        process.wait()
