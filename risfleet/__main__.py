"""``python -m risfleet``: the ``risfleet`` command."""

from __future__ import annotations

import sys

from experiments.cli import main

if __name__ == "__main__":
    sys.exit(main())
