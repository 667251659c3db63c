"""Imports go one way: physics and agents know nothing of Flower, apps nothing of each other."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
OURS = ("env", "agent", "conf", "client_app", "server_app", "experiments")

# What each part may import beyond the standard library. The first prefix that fits a module
# holds, so exceptions stand above the rule.
RULES = {
    "env.link": {"env.link", "numpy"},
    "env.drawing": {"env", "numpy", "matplotlib"},
    "env.picture": {"env", "numpy", "matplotlib"},
    "env.parallel_env": {"env", "numpy", "gymnasium", "pettingzoo"},
    "env.single_robot": {"env", "numpy", "gymnasium", "pettingzoo"},
    "env": {"env", "numpy", "annotated_types"},
    "agent": {"agent", "numpy", "torch", "safetensors", "threadpoolctl", "annotated_types"},
    "conf": {"conf", "agent", "env", "hydra", "omegaconf", "yaml", "annotated_types"},
    "client_app": {"client_app", "agent", "env", "conf", "flwr", "numpy"},
    "server_app": {
        "server_app", "agent", "env", "conf", "flwr", "numpy",
        "matplotlib", "safetensors", "torch.utils.tensorboard", "cryptography",
    },
    "experiments": {
        *OURS, "flwr", "numpy", "torch", "safetensors", "matplotlib", "rich", "ray",
        "gymnasium", "pettingzoo", "hydra", "omegaconf", "cryptography",
    },
}  # fmt: skip

# The package registers a view with Gymnasium where that is installed, and names its views.
PACKAGE = "env"
VIEWS = {"env.drawing", "env.picture", "env.parallel_env", "env.single_robot"}
PHYSICS = [
    "env." + name
    for name in (
        "allocation", "destinations", "oracles", "radio_map", "seeding", "slice", "tally", "world"
    )
]  # fmt: skip


@cache
def modules():
    """Every module of ours with its syntax tree."""
    found = {}
    for package in OURS:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            found[name] = ast.parse(path.read_text())
    return found


def rule_of(module):
    """The part that a module belongs to."""
    return next(part for part in RULES if module == part or module.startswith(part + "."))


def absolute(module, node):
    """The module that a ``from`` import names, relative ones resolved."""
    if not node.level:
        return node.module
    is_package = (ROOT / module.replace(".", "/")).is_dir()
    parts = module.split(".")
    above = parts[: len(parts) - node.level + is_package]
    return ".".join([*above, node.module] if node.module else above)


def names(module, tree):
    """What the import statements in a tree import: modules of ours as deep as they exist."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            source = absolute(module, node)
            for alias in node.names:
                inner = f"{source}.{alias.name}"
                yield inner if inner in modules() else source


def at_import_time(tree):
    """The tree without function bodies and without what only type checkers read."""
    kept = ast.Module(body=[], type_ignores=[])
    pending = list(tree.body)
    while pending:
        node = pending.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.Import | ast.ImportFrom):
            kept.body.append(node)
        pending += [child for child in ast.iter_child_nodes(node) if isinstance(child, ast.stmt)]
        pending += [
            statement
            for child in ast.iter_child_nodes(node)
            if isinstance(child, ast.excepthandler | ast.match_case)
            for statement in child.body
        ]
    return kept


def fits(name, allowed):
    return any(name == part or name.startswith(part + ".") for part in allowed)


def offences(module, tree, allowed):
    return sorted(
        {
            name
            for name in names(module, tree)
            if name.split(".")[0] not in sys.stdlib_module_names and not fits(name, allowed)
        }
    )


@pytest.mark.parametrize("module", [*modules()])
def test_a_module_imports_only_what_its_part_may(module):
    """Holds for lazy imports inside functions, too: a direction is a direction."""
    allowed = RULES[rule_of(module)] | ({"gymnasium"} if module == PACKAGE else set())
    assert offences(module, modules()[module], allowed) == []


@pytest.mark.parametrize(
    "module", [m for m in modules() if rule_of(m) in ("env", "env.link") and m != PACKAGE]
)
def test_the_physics_and_the_link_know_no_views(module):
    assert VIEWS.isdisjoint(names(module, modules()[module]))


def test_the_physics_needs_nothing_but_numpy():
    hidden = ("gymnasium", "pettingzoo", "matplotlib", "torch", "flwr", "hydra", "omegaconf")
    program = (
        f"import sys; sys.modules.update(dict.fromkeys({hidden!r}))\n"
        f"import {', '.join(PHYSICS)}\n"
        "config = env.config.EnvConfig()\n"
        "scenario = env.scenario.Scenario.drawn(config, 0)\n"
        "world = env.world.World(scenario, env.seeding.stream(0, env.seeding.Stream.WORLD))\n"
        "world.reset(); print(world.driving.all())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (done.stdout.strip(), done.stderr) == ("True", "")


def test_the_apps_and_the_command_are_where_the_rules_expect_them():
    assert {name.split(".")[0] for name in modules()} == set(OURS)
    assert {rule_of(name) for name in modules()} >= {*OURS, "env.link", "env.drawing"}


def test_no_module_imports_itself_through_others():
    """Imports made inside functions are left out: they run when both modules are whole."""
    graph = {
        module: {
            name
            for name in names(module, at_import_time(tree))
            if name in modules() and name != module
        }
        for module, tree in modules().items()
    }
    while leaves := [module for module, imported in graph.items() if not imported]:
        for leaf in leaves:
            del graph[leaf]
        for imported in graph.values():
            imported.difference_update(leaves)
    assert graph == {}


SAMPLES = [
    ("env.world", "import torch", ["torch"]),
    ("env.world", "import numpy as np\nimport math", []),
    ("env.world", "def f():\n    import flwr", ["flwr"]),
    ("env.world", "from matplotlib.figure import Figure", ["matplotlib.figure"]),
    ("env.drawing", "from matplotlib.figure import Figure", []),
    ("env.link.wire", "from env.world import World", ["env.world"]),
    ("env.link.wire", "from . import layout\nfrom .. import world", ["env.world"]),
    ("agent.dqn", "from env import actions", ["env.actions"]),
    ("client_app.app", "from server_app.rounds import x", ["server_app.rounds"]),
    ("server_app.app", "import torch", ["torch"]),
    ("server_app.app", "from torch.utils.tensorboard import SummaryWriter", []),
]


@pytest.mark.parametrize(("module", "source", "found"), SAMPLES)
def test_these_rules_catch_what_they_should(module, source, found):
    assert offences(module, ast.parse(source), RULES[rule_of(module)]) == found


def test_only_imports_that_run_at_once_make_a_cycle():
    source = (
        "from typing import TYPE_CHECKING\n"
        "if TYPE_CHECKING:\n    import a\n"
        "try:\n    import b\nexcept ImportError:\n    import c\n"
        "class D:\n    import d\n    def f(self):\n        import e\n"
    )
    found = set(names("x", at_import_time(ast.parse(source))))
    assert found == {"typing", "b", "c", "d"}
