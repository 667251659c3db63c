"""Agents are tested as they run: on one thread."""

import pytest

from agent import single_threaded


@pytest.fixture(autouse=True, scope="session")
def _one_thread():
    single_threaded()
