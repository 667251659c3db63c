"""JSON as the standard has it: no NaN and no infinity."""

from __future__ import annotations

import json
import math
from typing import Any


def to_json(values: dict[str, Any]) -> str:
    """Values as strict JSON: what is not a finite number becomes null."""
    return json.dumps(_finite(values), indent=2) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
