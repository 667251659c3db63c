"""The ``risfleet`` command."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from experiments.console.mishaps import in_words
from experiments.console.steady import steady_output

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (
    *("agent", "client_app", "conf", "env", "lockstep"),
    *("repeatable", "server_app", "storage", "training"),
)

USAGE = """\
usage: risfleet COMMAND ...

  train [KEY=VALUE ...]      train a fleet; -m KEY=A,B,... runs every combination
  evaluate RUN [options]     play a run's frozen weights on held-out starts; or, in the place of
                             RUN, baseline=shortest_canonical and others that learn nothing
  oracle RUN | KEY=VALUE ... what oracles reach, and a run's gap to them
  reproduce TARGET           the paper's figures and other tables: trains what they need
  status RUN                 where a run is
  watch RUN                  a page on this machine that follows a run
  replay RUN --out FILE      an episode as a page (.html) or a film (.gif, .mp4)
  map [KEY=VALUE ...]        what the RIS gains on a radio map; --out FILE.png draws it
  keys DIR [options]         makes the certificates and keys of a secured fleet

  COMMAND --help             what a command takes; --version prints the version
  --completion SHELL         prints what completes this command in bash, zsh or fish
  --config-dir DIR           with KEY=VALUE: groups and floor plans of your own, beside ours

Examples:
  risfleet train experiment=quick
  risfleet train env.robots=4 seed=1 runtime=local
  risfleet train -m seed=0,1,2 runtime=local
  risfleet evaluate runs/NAME --episodes 200

Keys and their defaults: risfleet train --cfg"""

TRAIN_USAGE = """\
usage: risfleet train [-m | --cfg] [--config-dir DIR] [KEY=VALUE ...]

Trains a fleet and writes a run folder.

  KEY=VALUE        sets a key, such as env.robots=4, or a group, such as experiment=quick
  -m, --multirun   runs every combination of the values given as KEY=A,B,...
  --cfg            prints every key with its value and trains nothing
  --objective M    what a search maximises (docs/hydra.md), such as success
  --config-dir DIR looks in DIR, too, for experiment/NAME.yaml and other groups
  -h, --help       prints this"""

STATUS_USAGE = """\
usage: risfleet status RUN

Says where the run in the folder RUN is.

  -h, --help       prints this"""

COMMANDS = ("train", "evaluate", "oracle", "reproduce", "status", "watch", "replay", "map", "keys")
"""Each is a module of ``experiments.commands``, which is loaded when it is asked for."""

COMPOSING = ("train", "evaluate", "oracle", "reproduce", "map")
"""Those that take KEY=VALUE."""

_USAGES = {"train": TRAIN_USAGE, "status": STATUS_USAGE}
"""Of the commands that do not print their own."""


@steady_output()
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command.

    Args:
        arguments: the command line without the program's name; ``sys.argv`` if None.

    Returns:
        The exit status: 0, 1 where a run failed, 2 for a user's mistake, 130 after Ctrl-C, 143
        after SIGTERM.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    if not given or given[0] in ("-h", "--help", "help"):
        print(USAGE)
        return 0 if given else 2
    if given[0] == "--version":
        print(f"risfleet {version('risfleet')}")
        return 0
    if given[0] in ("--completion", "--complete"):
        return _complete(given)
    name, rest = given[0], given[1:]
    if name not in COMMANDS:
        print(f"risfleet: {name!r} is no command: there are {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    if name in _USAGES and not {"-h", "--help"}.isdisjoint(rest):
        print(_USAGES[name])
        return 0
    if hidden := hidden_package():
        print(f"risfleet: {hidden}", file=sys.stderr)
        return 2
    from conf import ConfigError
    from env.plugins import PluginError

    try:
        if name in COMPOSING:
            from experiments.console.arguments import with_config_dirs

            rest = with_config_dirs(rest)
        return int(import_module(f"experiments.commands.{name}").main(rest))
    except KeyboardInterrupt:
        return 130
    except (ConfigError, PluginError) as error:
        print(f"risfleet: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"risfleet: {in_words(error)}", file=sys.stderr)
        return 1


def _complete(given: list[str]) -> int:
    """Prints a shell's script, or for that script what completes a line; the exit status."""
    from conf import ConfigError
    from experiments import completion

    try:
        if given[0] == "--completion":
            print(completion.script(" ".join(given[1:])))
        else:
            line = os.environ.get("COMP_LINE", "")
            print("\n".join(completion.candidates(line, COMMANDS, COMPOSING)))
    except ConfigError as error:
        print(f"risfleet: {error}", file=sys.stderr)
        return 2
    return 0


def hidden_package() -> str:
    """Which package of ours another one hides, in a sentence; empty if none does."""
    for name in PACKAGES:
        spec = find_spec(name)
        origin = Path(str(spec.origin)).resolve() if spec is not None else None
        if origin != ROOT / name / "__init__.py":
            say = f"rename it, or take its folder off PYTHONPATH; RISFleet's own is in {ROOT}"
            return f"{origin} hides the package {name} of RISFleet: {say}."
    return ""


if __name__ == "__main__":
    sys.exit(main())
