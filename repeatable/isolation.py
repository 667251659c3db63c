"""Global state that Flower and apps use, seeded or left as it was found."""

from __future__ import annotations

import logging
import random
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from flwr.supercore.task_identity import TaskIdentity


@contextmanager
def seeded(*entropy: int) -> Iterator[None]:
    """Seeds the global generators for a while, and puts them back as they were.

    These are Python's, NumPy's and, where the process has imported it, torch's of the processor.

    Args:
        entropy: whole numbers of at least 0 that name the stream, such as seed, round and client.
    """
    words = np.random.SeedSequence(entropy).generate_state(4)
    python, legacy = random.getstate(), np.random.get_state()  # noqa: NPY002  # others draw from it
    torch = sys.modules.get("torch")
    torch_state = torch.get_rng_state() if torch else None
    random.seed(words.tobytes())
    np.random.seed(words)  # noqa: NPY002
    if torch:
        torch.manual_seed(int(words[0]))
    try:
        yield
    finally:
        random.setstate(python)
        np.random.set_state(legacy)  # noqa: NPY002
        if torch and torch_state is not None:
            torch.set_rng_state(torch_state)


@contextmanager
def within_flower() -> Iterator[None]:
    """Lets Flower's code run and leaves nothing behind in the process.

    FedAvg draws nodes with the global ``random``, which is put back. Messages need the identity of
    a Flower task, which is made up where the process has none and left alone where it has. Only
    this thread is silenced, so Flower's own threads may go on logging.
    """
    randomness = random.getstate()
    unset = [name for name in _IDENTITY if getattr(TaskIdentity, name) is None]
    silence = _Silence()
    logger = logging.getLogger("flwr")
    logger.addFilter(silence)
    for name in unset:
        setattr(TaskIdentity, name, 1)
    try:
        yield
    finally:
        for name in unset:
            setattr(TaskIdentity, name, None)
        logger.removeFilter(silence)
        random.setstate(randomness)


_IDENTITY = ("_task_id", "_run_id", "_node_id")


class _Silence(logging.Filter):
    """Drops what the thread that made it logs below an error."""

    def __init__(self) -> None:
        super().__init__()
        self._thread = threading.get_ident()

    def filter(self, record: logging.LogRecord) -> bool:
        return record.levelno >= logging.ERROR or threading.get_ident() != self._thread
