"""Ends a session whose owner died without ending it (killed, crashed, out of memory).

The owner holds the other end of this process's standard input and writes a line for every process
that it starts: number, tab, start. The end of that file is the owner's end, however it came.
"""

from __future__ import annotations

import shutil
import signal
import sys
from pathlib import Path

from repeatable.processes import Process, terminate


def main() -> None:
    """Wait for the owner's end, then end what carries the marker or works in its folder."""
    marker, folder = sys.argv[1], Path(sys.argv[2])
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    roots = set()
    for line in sys.stdin:
        pid, started = line.rstrip("\n").split("\t")
        roots.add(Process(int(pid), started))
    terminate(marker, roots, folder)
    shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
