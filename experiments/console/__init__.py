"""What a person sees while runs go on."""

from __future__ import annotations

from typing import Any

PLAIN: dict[str, Any] = {"markup": False, "emoji": False, "highlight": False, "soft_wrap": True}
"""Options of ``rich``'s ``Console.print`` for text in which anything may stand, as it is."""
