"""Configurations that are composed once, and changed by keys."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from conf import Config, compose, overridden
from conf.overrides import GROUPS

Compose = Callable[[Sequence[str]], Config]


@pytest.fixture(scope="session", params=["keys", pytest.param("hydra", marks=pytest.mark.slow)])
def composed(request: pytest.FixtureRequest) -> Compose:
    """``compose``, also as it leaves Hydra out where keys alone are set: that takes a fifth."""
    if request.param == "hydra":
        return compose
    defaults = compose()

    def make(overrides: Sequence[str]) -> Config:
        needed = any(item.partition("=")[0] in GROUPS or "${" in item for item in overrides)
        return compose(overrides) if needed else overridden(defaults, overrides)

    return make
