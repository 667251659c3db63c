"""An episode of a run to look at: in a notebook's cell, as a page or as a film."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

from conf.user_paths import user_path
from experiments.viewer.page import page
from experiments.viewer.saving import save

HEIGHT_PX = 780


@dataclass(frozen=True)
class Replay:
    """Episodes side by side, from one start; a notebook shows it as a page that plays.

    Attributes:
        title: of the page.
        panels: each a "title", a "scene" and an "episode" slot by slot (docs/watching.md).
    """

    title: str
    panels: Sequence[dict[str, Any]] = field(repr=False)

    @property
    def html(self) -> str:
        """The page, which needs nothing from elsewhere."""
        return page(self.title, {"panels": self.panels})

    def save(self, path: str | os.PathLike[str], *, frames_per_slot: int = 2) -> Path:
        """Writes it, and returns where.

        Args:
            path: a page, ``.html``, or a film, ``.gif`` or ``.mp4``.
            frames_per_slot: pictures of a film for each slot.

        Raises:
            ConfigError: another ending, no such folder, or a film's package is missing.
        """
        out = user_path(os.fspath(path))
        save(self.panels, self.title, out, frames_per_slot)
        return out

    def _repr_html_(self) -> str:
        """The page in a frame of its own."""
        frame = f'sandbox="allow-scripts" style="width:100%;height:{HEIGHT_PX}px;border:0"'
        title, source = escape(self.title), escape(self.html)
        return f'<iframe title="{title}" {frame} srcdoc="{source}"></iframe>'
