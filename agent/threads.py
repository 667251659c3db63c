"""One thread of arithmetic per process.

The products of a DQN are so small that a second thread costs more than it gives (7 to 9 times
slower on a busy machine), and how work is split among threads may change the last bits.
"""

from __future__ import annotations

import torch
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]  # it ships none


def single_threaded() -> None:
    """Holds torch's and NumPy's linear algebra to one thread each; harmless when repeated."""
    if torch.get_num_threads() != 1:
        torch.set_num_threads(1)
    threadpool_limits(1, user_api="blas")
