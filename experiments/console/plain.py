"""How text is printed in which anything may stand, such as the name of a folder."""

from __future__ import annotations

from typing import Any

PLAIN: dict[str, Any] = {"markup": False, "emoji": False, "highlight": False, "soft_wrap": True}
"""Options of ``rich``'s ``Console.print``: text as it is, on a line of its own."""
