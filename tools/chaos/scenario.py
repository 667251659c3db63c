"""A run from its beginning to its end, with kills on the way."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from repeatable.process_tracker import LAUNCHER, Deck
from storage.checkpoint_files import CheckpointError
from tools.chaos.attempt import HUNG, Attempt, AttemptOutcome, Hit
from tools.chaos.kill_points import KillPoint, draw, newest
from tools.chaos.tasks import ROBOTS, Runtime
from tools.chaos.verdict import differences, has_ended, is_clear, resumed_window, unfinished
from training.checkpoint import latest

REFUSED = 2
ATTEMPTS = 12
"""Processes that one run may take; far more than it is struck."""

NOTHING_YET = ("holds no checkpoint that", "allowed is the folder of a run")
"""What a resume says of a run that died before its first checkpoint."""


@dataclass
class Row:
    """A kill and what came of it.

    Attributes:
        run: number of the run.
        runtime: of the run.
        role: of the process that was killed.
        moment: kind of the moment.
        window: the newest window that the server had a checkpoint of.
        happened: what became of the run.
        seconds: until the launcher had ended, or the run was further than before.
        unfinished: files that were half written when the launcher had ended; none of them counts.
        survived: whether all was as promised.
        reason: why not.
    """

    run: int
    runtime: str
    role: str
    moment: str
    window: int
    happened: str
    seconds: float
    unfinished: str = ""
    survived: bool = True
    reason: str = ""


@dataclass
class KillScenario:
    """Plays a run until it has ended, with as many kills as planned.

    Args:
        number: of the run.
        runtime: where it is played.
        reference: folder of the run that nobody disturbed.
        scratch: a folder of its own, with a short path.
        kills: how many are planned.
        rng: of the suite.
        deck: whom to kill.
    """

    number: int
    runtime: Runtime
    reference: Path
    scratch: Path
    kills: int
    rng: random.Random
    deck: Deck
    rows: list[Row] = field(default_factory=list)
    _reasons: list[str] = field(default_factory=list)
    _runs: int = 0

    def play(self, tell: Callable[[Row], None] = lambda row: None) -> list[Row]:
        """Plays it; rows that did not survive say why, and leave the scratch folder.

        Args:
            tell: given each row as soon as it is known, before the run's end is.
        """
        folder = self._new_folder()
        given = self.runtime.begin(folder)
        for _ in range(ATTEMPTS):
            outcome = self._attempt(given, folder)
            for row in self._judge(outcome, folder):
                self.rows.append(row)
                tell(row)
            if outcome.status == 0 or _had_ended(outcome, folder):
                self._reasons += differences(folder, self.reference)
                break
            if outcome.status == REFUSED and self._has_nothing(outcome, folder):
                folder = self._new_folder()
                given = self.runtime.begin(folder)
            elif not outcome.hits:
                self._reasons.append(f"undisturbed, it ended with {_ending(outcome)}")
                break
            else:
                given = [f"resume={folder}"]
        else:
            self._reasons.append(f"not at its end after {ATTEMPTS} processes")
        return self._close()

    def _attempt(self, given: list[str], folder: Path) -> AttemptOutcome:
        """One process, struck if a kill is left."""
        moments = self._plan(folder)
        expected = _common(folder)
        with Attempt(given, folder, self.scratch, self.runtime) as attempt:
            for moment in moments:
                if not attempt.strike(moment, self.deck):
                    break
                self.kills -= 1
            outcome = attempt.finish()
        window = resumed_window(outcome.printed)
        if window is not None and window != expected:
            self._reasons.append(f"resumed from window {window} where {expected} is the last")
        if outcome.left:
            after = "; ".join(hit.role for hit in outcome.hits) or "nothing"
            self._reasons.append(f"left behind after a kill of {after}: {', '.join(outcome.left)}")
        if folders := [path.name for path in self.scratch.glob("rf-*")]:
            self._reasons.append(f"left behind: the folders {folders}")
            for name in folders:
                shutil.rmtree(self.scratch / name, ignore_errors=True)
        return outcome

    def _plan(self, folder: Path) -> list[KillPoint]:
        """The kills of the next process: one, or two where a run goes on by itself."""
        count = min(self.kills, 1)
        if self.runtime.name == "deployment" and self.kills > 1 and self.rng.random() < 0.4:
            count = 2
        first, moments = newest(folder / "state", ROBOTS), []
        for _ in range(count):
            moments.append(draw(self.rng, self.runtime, first))
            first = max(first, moments[-1].window)
        return moments

    def _judge(self, outcome: AttemptOutcome, folder: Path) -> Iterator[Row]:
        """A row for each kill of a process; what was wrong becomes a reason of the run."""
        limit_s = self.runtime.ends_within_s
        launcher_died = any(hit.role == LAUNCHER for hit in outcome.hits)
        if outcome.status == HUNG:
            self._reasons.append(f"it hung, {outcome.ended_s:.0f} s after the last kill")
        elif outcome.status != 0 and outcome.hits and not launcher_died:
            if not is_clear(outcome.errors):
                self._reasons.append(f"no clear sentence: {outcome.errors[-800:]!r}")
            if outcome.ended_s > limit_s:
                self._reasons.append(f"it ended {outcome.ended_s:.0f} s after the kill")
            for hit in outcome.hits:
                if hit.role in self.runtime.comes_back and hit.window:
                    self._reasons.append(f"{hit.role} did not come back: {_ending(outcome)}")
        for hit in outcome.hits:
            row = self._row(hit, outcome)
            row.unfinished = " ".join(unfinished(folder))
            yield row

    def _row(self, hit: Hit, outcome: AttemptOutcome) -> Row:
        seconds = outcome.ended_s
        if outcome.status == 0:
            happened = "went on to its end"
            seconds = outcome.ended_s if hit.further_s is None else hit.further_s
        elif hit.role == LAUNCHER:
            happened, seconds = "all ended with it", outcome.ended_s + outcome.gone_s
        else:
            happened = _ending(outcome)
        place = (self.number, self.runtime.name, hit.role, hit.moment.kind, hit.window)
        return Row(*place, happened, round(seconds, 2))

    def _has_nothing(self, outcome: AttemptOutcome, folder: Path) -> bool:
        """Whether a resume was refused because there is nothing to go on from."""
        if not any(text in outcome.errors for text in NOTHING_YET):
            return False
        if len(outcome.errors.strip().splitlines()) != 1:
            self._reasons.append(f"not one sentence: {outcome.errors!r}")
        if (window := _common(folder)) is not None:
            self._reasons.append(f"a resume was refused in spite of the checkpoint of {window}")
        return True

    def _new_folder(self) -> Path:
        self._runs += 1
        return self.scratch / f"run-{self._runs}"

    def _close(self) -> list[Row]:
        """Gives every kill of the run the verdict of its end."""
        if self._reasons:
            for row in self.rows:
                row.survived, row.reason = False, "; ".join(self._reasons)
        else:
            shutil.rmtree(self.scratch)
        return self.rows


def _common(folder: Path) -> int | None:
    """The window of the newest checkpoint that all have, None if there is none."""
    try:
        return latest(folder / "state", ROBOTS).window
    except CheckpointError:
        return None


def _had_ended(outcome: AttemptOutcome, folder: Path) -> bool:
    """Whether a resume was refused because the run had ended before its process died."""
    refused = outcome.status == REFUSED and "the run has ended" in outcome.errors
    return refused and has_ended(folder)


def _ending(outcome: AttemptOutcome) -> str:
    """How a process that did not succeed ended, in one line."""
    if outcome.status == HUNG:
        return "hung"
    lines = outcome.errors.strip().splitlines()
    return f"status {outcome.status}: {lines[0] if lines else 'no word'}"
