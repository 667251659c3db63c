"""The ``risfleet`` command."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

USAGE = """\
usage: risfleet COMMAND ...

  train [KEY=VALUE ...]      train a fleet; -m KEY=A,B,... runs every combination
  evaluate RUN [options]     play a run's frozen weights on held-out starts
  status RUN                 where a run is

Examples:
  risfleet train experiment=quick
  risfleet train env.robots=4 seed=1 runtime=local
  risfleet train -m seed=0,1,2 runtime=local
  risfleet evaluate runs/NAME --episodes 200

Keys and their defaults: risfleet train --cfg"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command.

    Args:
        arguments: the command line without the program's name; ``sys.argv`` if None.

    Returns:
        The exit status: 0, 1 where a run failed, 2 for a user's mistake, 130 after Ctrl-C.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    if not given or given[0] in ("-h", "--help", "help"):
        print(USAGE)
        return 0 if given else 2
    name, rest = given[0], given[1:]
    command = _COMMANDS.get(name)
    if command is None:
        print(
            f"risfleet: {name!r} is no command: there are {', '.join(_COMMANDS)}", file=sys.stderr
        )
        return 2
    try:
        return command(rest)
    except KeyboardInterrupt:
        return 130


def _train(arguments: Sequence[str]) -> int:
    from experiments.train import main

    return main(arguments)


def _evaluate(arguments: Sequence[str]) -> int:
    from experiments.evaluate import main

    return main(arguments)


def _status(arguments: Sequence[str]) -> int:
    from experiments.status import main

    return main(arguments)


_COMMANDS: dict[str, Callable[[Sequence[str]], int]] = {
    "train": _train,
    "evaluate": _evaluate,
    "status": _status,
}

if __name__ == "__main__":
    sys.exit(main())
