"""Pages that need nothing from elsewhere: markup, style, script and data in one file."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from html import escape
from importlib.resources import files
from typing import Any

SCRIPTS = ("panel.js", "player.js", "charts.js", "watch.js", "main.js")


def page(title: str, data: Mapping[str, Any]) -> str:
    """A whole page.

    Args:
        title: of the page.
        data: "panels", each a "title", a "scene" as ``scene.scene``, and an "episode" as
            ``training.trace.recorded``; a page that "follows" a run asks its server for them.
    """
    parts = {
        "TITLE": escape(title),
        "STYLE": _part("style.css"),
        "DATA": json.dumps(data, separators=(",", ":")).replace("<", "\\u003c"),
        "SCRIPT": "\n".join(map(_part, SCRIPTS)),
    }
    return re.sub("@([A-Z]+)@", lambda place: parts[place[1]], _part("page.html"))


def _part(name: str) -> str:
    return files(__package__).joinpath("page", name).read_text(encoding="utf-8")
