"""Completion of the command line in bash, zsh and fish: commands, options, keys and choices."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, get_args, get_origin

from conf import ConfigError, own_groups
from conf.overrides import FOLDER, GROUPS, all_keys, hint_of, parse
from env.geometry import floor_plans
from experiments.console.arguments import CONFIG_DIR, with_config_dirs

BASH = """\
_risfleet() {
    local IFS=$'\\n' line="${COMP_LINE:0:$COMP_POINT}" word
    COMPREPLY=($(COMP_LINE="$line" "${COMP_WORDS[0]}" --complete 2>/dev/null))
    word="${line##*[[:space:]]}"
    if [[ $word == *=* && $COMP_WORDBREAKS == *=* ]]; then
        COMPREPLY=("${COMPREPLY[@]#"${word%%=*}="}") # readline begins a word behind each =
    fi
    [[ ${#COMPREPLY[@]} -eq 1 && ${COMPREPLY[0]} == *[=.] ]] && compopt -o nospace 2>/dev/null
    return 0
}
complete -o default -F _risfleet risfleet"""

SCRIPTS = {
    "bash": BASH,
    "zsh": f"autoload -Uz +X bashcompinit && bashcompinit\n{BASH}",
    "fish": "complete -c risfleet -a '(COMP_LINE=(commandline -cp) risfleet --complete)'",
}

TRAIN = ("-m", "--multirun", "--cfg", "--objective", "--help", *CONFIG_DIR[:1])
MAIN = ("--help", "--version", "--completion")


def script(shell: str) -> str:
    """What a shell reads, as in ``eval "$(risfleet --completion bash)"``.

    Raises:
        ConfigError: there is none for that shell.
    """
    if shell not in SCRIPTS:
        raise ConfigError(f"--completion {shell}: allowed is one of {', '.join(SCRIPTS)}.")
    return SCRIPTS[shell]


def candidates(line: str, commands: Sequence[str], composing: Sequence[str]) -> list[str]:
    """What the last word of a line may become; nothing where it is a file's name.

    Args:
        line: up to the cursor.
        commands: names of all.
        composing: those that take KEY=VALUE.
    """
    try:
        words = shlex.split(line)
    except ValueError:  # an open quote
        return []
    word = words.pop() if words and not line[-1:].isspace() else ""
    if len(words) < 2:
        return _beginning(word, (*commands, *MAIN))
    command, before = words[1], words[2:]
    if command == MAIN[2]:
        return _beginning(word, SCRIPTS)
    if command not in commands or words[-1] in (*CONFIG_DIR, "--out", "--json", "--channels"):
        return []
    if words[-1] == "--objective":
        from experiments.batch.search import MEASURES

        return _beginning(word, MEASURES)
    if word.startswith("-"):
        return _beginning(word, _options(command, composing))
    if command == "reproduce" and not [item for item in before if not item.startswith("-")]:
        from experiments.reproduce.targets.plan import TARGETS

        return _beginning(word, (*TARGETS, "all"))
    return list(_overrides(word, _roots(before))) if command in composing else []


def _beginning(word: str, names: Iterable[str]) -> list[str]:
    return [name for name in names if name.startswith(word)]


def _options(command: str, composing: Sequence[str]) -> list[str]:
    """The options of a command."""
    if command == "train":
        return [*TRAIN]
    module = import_module(f"experiments.commands.{command}")
    names = []
    if hasattr(module, "_parser"):
        names = [name for action in module._parser()._actions for name in action.option_strings]
    return [*names, *(CONFIG_DIR[:1] if command in composing else ())]


def _roots(words: Sequence[str]) -> list[Path]:
    """The folders that groups lie in, those of the user's that the line names included."""
    try:
        arguments = with_config_dirs(words)
        found = own_groups.folders_of(parse([w for w in arguments if w.startswith(own_groups.KEY)]))
    except ConfigError:
        found = []
    return [FOLDER, *found]


def _overrides(word: str, roots: Sequence[Path]) -> Iterator[str]:
    """Keys, up to their next dot, or the values of one."""
    key, equals, value = word.partition("=")
    if equals:
        listed, comma, last = value.rpartition(",")
        for choice in _choices(key, roots):
            if choice.startswith(last):
                yield f"{key}={listed}{comma}{choice}"
        return
    names = [name for name in (*GROUPS, *all_keys()) if name.startswith(word)]
    ends = [(name, name.find(".", len(word)) + 1) for name in names]
    yield from dict.fromkeys(name[:end] if end else f"{name}=" for name, end in ends)


def _choices(key: str, roots: Sequence[Path]) -> list[str]:
    """The values that a key may have, if they can be listed."""
    if key in GROUPS:
        return sorted(own_groups.files(key, roots))
    if key == "env.plan":
        return floor_plans.built_in()
    try:
        hint = hint_of(key)
    except ConfigError:
        return []
    return [*_values(hint)]


def _values(hint: Any) -> Iterator[str]:
    """The values of an annotation: of its ``Literal``, truths and null."""
    for part in (hint, *get_args(hint)):
        if get_origin(part) is Literal:
            yield from get_args(part)
        elif part is bool:
            yield from ("true", "false")
        elif part is NoneType:
            yield "null"
        elif isinstance(part, UnionType) and part is not hint:
            yield from _values(part)
