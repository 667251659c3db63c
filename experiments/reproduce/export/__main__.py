"""``python -m experiments.reproduce.export``."""

import sys

from experiments.reproduce.export.collect import main

sys.exit(main())
