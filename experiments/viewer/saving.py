"""Episodes written as a page or as a film, by the ending of a file's name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from conf import ConfigError
from experiments.console.arguments import check_place
from experiments.viewer.page import page
from experiments.viewer.replays import Panel
from storage.atomic import write_atomically

PAGE, FILMS = ".html", (".gif", ".mp4")
MOST_FRAMES = {".gif": 6, ".mp4": 10}
"""For each slot; browsers show a GIF's pictures for no less than 20 ms."""


def check_out(out: Path) -> None:
    """Finds a file that cannot be written before anything is played.

    Raises:
        ConfigError: its ending is none of those known, or its folder is not there.
    """
    if out.suffix not in (PAGE, *FILMS):
        allowed = ", ".join((PAGE, *FILMS))
        raise ConfigError(f"--out {out}: allowed is a file that ends in one of {allowed}.")
    check_place("--out", out)


def save(panels: Sequence[Panel], title: str, out: Path, frames_per_slot: int) -> None:
    """Writes episodes side by side.

    Args:
        panels: the episodes.
        title: of a page.
        out: see ``check_out``.
        frames_per_slot: pictures of a film for each slot.

    Raises:
        ConfigError: see ``check_out``; or a film needs a package that is missing.
    """
    check_out(out)
    most = MOST_FRAMES.get(out.suffix, frames_per_slot)
    if not 1 <= frames_per_slot <= most:
        raise ConfigError(f"--frames {frames_per_slot}: allowed is 1 to {most} of a {out.suffix}.")
    if out.suffix == PAGE:
        write_atomically(out, page(title, {"panels": panels}))
    else:
        from experiments.viewer.film import save_film  # matplotlib: where it is wanted

        save_film(panels, out, frames_per_slot)
