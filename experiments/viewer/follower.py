"""What the page of a run is told, read from the run's folder alone."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from conf import Config, has_rooms
from conf.rooms import Room
from env.scenario import Scenario
from experiments.console.display import SILENT_S, describe, silent_s
from experiments.viewer.replays import Panel
from experiments.viewer.scene import scene
from training.recording.csv_log import read_columns
from training.rooms import known_rooms
from training.run_folder import RunFolder

POINTS = 400
"""Most points of a curve: of more, means of neighbours are shown."""

DRAWN = ("success", "ee", "reward")

UNREADABLE = (ValueError, KeyError, TypeError, AttributeError, IndexError, OSError)
"""What files end in that are damaged, of another version, or moved: a page says so and goes on."""

Event = tuple[str, str]
"""A name, and data as JSON."""

Stamps = tuple[tuple[int, int], ...]
Scores = dict[tuple[str, str], dict[str, str]]


class Follower:
    """Reads a run's folder again and again, and tells what has changed.

    Args:
        folder: of the run, which has written its configuration.

    Raises:
        ConfigError: there is no such folder, or its configuration is wrong.
    """

    def __init__(self, folder: RunFolder) -> None:
        self.folder = folder
        self.config = folder.read_config()
        self._scenes: dict[str, dict[str, Any]] = {}
        self._rooms: list[Room] | None = None
        self._made: dict[tuple[Path, ...], tuple[Stamps, Any]] = {}

    def events(self) -> Iterator[Event]:
        """Everything that the page shows, in its present state; one after the other.

        "status" with what the run says of itself, "curves", and "panel", the newest recorded
        episode; or, of a building, "rooms", each with what it has come to and a version that
        changes with its newest episode.
        """
        files = self.folder.metrics_file, self.folder.evaluations_file
        parts: dict[str, Callable[[], str]] = {}
        parts["curves"] = lambda: str(self._current(self._curves, *files))
        if has_rooms(self.config):
            parts["rooms"] = lambda: json.dumps([*self._wall()])
        else:
            parts["panel"] = lambda: json.dumps(self.panel())
        found, wrong = {}, []
        for name, make in parts.items():
            try:
                found[name] = make()
            except UNREADABLE as error:
                wrong.append(f"{type(error).__name__}: {error}")
        try:
            yield "status", self._status(wrong)
        except UNREADABLE as error:
            said = f"the run's progress cannot be shown: {type(error).__name__}: {error}"
            yield "status", json.dumps({"said": said, "figures": [], "clients": []})
        yield from found.items()

    def panel(self, name: str | None = None) -> Panel | None:
        """The newest episode of the run, or of one of a building's rooms; None if there is none.

        Args:
            name: of the room.
        """
        folder, config = self.folder, self.config
        if name is not None:
            room = next((room for room in self.rooms() if room.name == name), None)
            if room is None:
                return None
            folder, config = folder.room(name), room.config(config)
        episode = folder.read_episode()
        if episode is None:
            return None
        title = f"Newest evaluation: episode {episode['episode']}, tick {episode['tick']}, greedy"
        title = f"Room {name}. {title}" if name else title
        return {"title": title, "scene": self._scene(config, name or ""), "episode": episode}

    def rooms(self) -> Sequence[Room]:
        """A building's rooms; none of a run without, or that has not written them yet."""
        if self._rooms is None:
            if not (has_rooms(self.config) and self.folder.rooms_file.is_file()):
                return []
            self._rooms = known_rooms(self.config, self.folder)
        return self._rooms

    def _scene(self, config: Config, name: str) -> dict[str, Any]:
        if name not in self._scenes:
            self._scenes[name] = scene(Scenario.drawn(config.env, config.seed))
        return self._scenes[name]

    # --- What the run says ------------------------------------------------------------------------

    def _status(self, wrong: Sequence[str]) -> str:
        status = self.folder.read_progress()
        if status is None:
            return json.dumps({"said": "not begun", "figures": [], "clients": []})
        figures = [(name, text) for name, text in describe(status) if name and text != "-"]
        if status.get("round"):
            figures.append(("round", str(status["round"])))
        if status.get("checkpoint") is not None:
            figures.append(("last checkpoint", f"window {status['checkpoint']}"))
        if (rooms := status.get("rooms")) is not None:
            figures.append(("rooms in the last round", f"{rooms['took_part']} of {rooms['count']}"))
        if status.get("losses"):
            figures.append(("clients lost and awaited", str(status["losses"])))
        silence = silent_s(status)
        silent = f", silent for {silence:.0f} s" if silence and silence > SILENT_S else ""
        said = " ".join(filter(None, [f"{status['state']}{silent}.", status["message"], *wrong]))
        clients = [[*_client(each)] for each in status.get("clients", ())]
        return json.dumps({"said": said, "figures": figures, "clients": clients})

    def _curves(self, metrics: Path, evaluations: Path) -> str:
        episodes, rows = _columns(metrics), _columns(evaluations)
        at = "tick" if has_rooms(self.config) else "episode"  # episodes are counted by room
        greedy = {name: values[1::2] for name, values in rows.items()}
        explored = {name: values[::2] for name, values in rows.items()}
        curves = {"train": episodes, "explored": explored, "greedy": greedy}
        drawn = {name: _thinned(columns, at) for name, columns in curves.items()}
        return json.dumps({"unit": at, **drawn})

    def _wall(self) -> Iterator[dict[str, str]]:
        newest: Scores = self._current(_newest, self.folder.rooms_log_file)
        for room in self.rooms():
            try:
                version = str(self.folder.room(room.name).episode_file.stat().st_mtime_ns)
            except OSError:
                continue  # not evaluated yet
            row = newest.get((str(int(room.held_out)), str(room.index)))
            said = f"{float(row['success']):.0%} arrive, EE {float(row['ee']):.3f}" if row else ""
            yield {"name": room.name, "said": said, "version": version}

    def _current(self, make: Callable[..., Any], *files: Path) -> Any:
        """What is made of files; made anew when one of them has changed."""
        stamps = tuple(map(_stamp, files))
        if files not in self._made or self._made[files][0] != stamps:
            self._made[files] = stamps, make(*files)
        return self._made[files][1]


def _stamp(path: Path) -> tuple[int, int]:
    """When a file was written and how long it is, zeros where there is none."""
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_mtime_ns, found.st_size


def _client(client: Mapping[str, Any]) -> Iterator[str]:
    """A row of the table of clients: who, state, traffic."""
    held = client.get("rooms", client.get("robots", ()))
    what = "rooms" if "rooms" in client else "robots"
    yield f"{what} {', '.join(map(str, held[:8]))}{', ...' if len(held) > 8 else ''}"
    missed = f", missed the last round: {client['missed']}" if client.get("missed") else ""
    yield ("connected" if client["connected"] else "not connected") + missed
    sent = client.get("bytes_sent", 0) + client.get("bytes_received", 0)
    yield f"{(sent + client['flower_bytes']) / 1e6:.1f} MB"


def _columns(path: Path) -> dict[str, list[float]]:
    """The columns of a file that a run writes, by name; none before it is there."""
    try:
        return {name: values.tolist() for name, values in read_columns(path).items()}
    except OSError:
        return {}


def _thinned(columns: Mapping[str, list[float]], at: str) -> dict[str, list[float | None]]:
    """At most ``POINTS`` of the drawn columns: means of neighbours, None where there is none."""
    places = columns.get(at, [])
    order = sorted(range(len(places)), key=places.__getitem__)  # rooms come to it one by one
    step = -(-len(order) // POINTS) or 1
    blocks = [order[first : first + step] for first in range(0, len(order), step)]
    drawn = {
        name: [_mean([columns[name][i] for i in block]) for block in blocks]
        for name in DRAWN
        if name in columns
    }
    return {"at": [places[block[-1]] for block in blocks], **drawn}


def _mean(values: Sequence[float]) -> float | None:
    finite = [value for value in values if value == value and abs(value) != float("inf")]
    return sum(finite) / len(finite) if finite else None


def _newest(path: Path) -> Scores:
    """The last greedy row of each room, by whether it is held out and its index."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = csv.DictReader(line for line in file if line.endswith("\n"))
            greedy = (row for row in rows if float(row["epsilon"]) == 0.0)
            return {(row["held_out"], row["room"]): row for row in greedy}
    except OSError:
        return {}
