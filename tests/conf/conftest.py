"""Configurations that are composed once, and changed by keys."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from conf import Config, compose, overridden
from conf.overrides import GROUPS

Compose = Callable[[Sequence[str]], Config]


@pytest.fixture(scope="session")
def composed() -> Compose:
    """``compose``, which leaves Hydra out where keys alone are set: that takes a fifth as long."""
    defaults = compose()

    def make(overrides: Sequence[str]) -> Config:
        keys = [override.partition("=")[0] for override in overrides]
        chooses = any(key in GROUPS or not key[:1].isalpha() for key in keys)
        return compose(overrides) if chooses else overridden(defaults, overrides)

    return make
