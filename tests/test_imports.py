"""Imports go one way, down the table of docs/architecture.md, never in a circle; short modules."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
OURS = (
    "env", "storage", "repeatable", "agent", "lockstep", "conf", "training", "client_app",
    "server_app", "experiments", "risfleet",
)  # fmt: skip
A_RUN = {"training", "lockstep", "env", "agent", "conf", "storage"}

# What each part may import beyond the standard library. The first prefix that fits a module
# holds, so exceptions stand above the rule.
RULES = {
    "env.rendering": {"env", "numpy", "matplotlib"},
    "env.apis": {"env", "numpy", "gymnasium", "pettingzoo"},
    "env": {"env", "numpy", "annotated_types"},
    "storage": {"storage", "numpy", "safetensors"},
    "repeatable.processes": {"psutil"},
    "repeatable": {"repeatable", "storage", "flwr", "numpy", "safetensors"},
    "agent": {"agent", "storage", "numpy", "torch", "threadpoolctl", "annotated_types"},
    "lockstep": {"lockstep", "env", "storage", "numpy"},
    "conf": {"conf", "agent", "env", "hydra", "omegaconf", "yaml", "annotated_types"},
    "training.aggregation": {*A_RUN, "repeatable", "numpy", "flwr"},
    "training.recording.figures": {*A_RUN, "numpy", "matplotlib"},
    "training.recording.trackers": {*A_RUN, "torch.utils.tensorboard", "wandb", "mlflow"},
    "training.recording": {*A_RUN, "numpy"},
    "training.run_folder": {*A_RUN, "numpy", "safetensors"},
    "training.room_messages": {*A_RUN, "numpy", "flwr"},
    "training": {*A_RUN, "numpy"},
    "client_app": {"client_app", *A_RUN, "flwr", "numpy"},
    "server_app": {"server_app", *A_RUN, "flwr", "numpy", "cryptography"},
    "experiments": {
        *OURS, "flwr", "numpy", "torch", "safetensors", "matplotlib", "rich", "ray",
        "gymnasium", "pettingzoo", "hydra", "omegaconf", "cryptography", "psutil", "PIL",
        "imageio_ffmpeg", "IPython", "yaml",
    },
    "risfleet": {*OURS, "numpy", "pandas", "rich"},
}  # fmt: skip

# The package registers views with libraries that are installed, and names its views.
PACKAGE = "env"
REGISTRIES = {"gymnasium", "pettingzoo"}
VIEWS = ("env.apis", "env.rendering")
PHYSICS = [
    "env." + name
    for name in (
        "downlink.allocation", "mdp.destinations", "oracles.per_slot", "radio.radio_map", "seeding",
        "local_env", "episode", "world",
    )
]  # fmt: skip
HEAVY = ("flwr", "matplotlib", "torch")


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


@cache
def is_package(module):
    return (ROOT / module.replace(".", "/")).is_dir()


def rule_of(module):
    """The part that a module belongs to."""
    return next(part for part in RULES if module == part or module.startswith(part + "."))


def absolute(module, node):
    """The module that a ``from`` import names, relative ones resolved."""
    if not node.level:
        return node.module
    parts = module.split(".")
    above = parts[: len(parts) - node.level + is_package(module)]
    return ".".join([*above, node.module] if node.module else above)


def names(module, tree, walk=ast.walk):
    """What the import statements in a tree import: modules of ours as deep as they exist."""
    for node in walk(tree):
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


@cache
def folder(module):
    """The folder of a module; where folders of ours stand beside it, it counts by itself."""
    package = module if is_package(module) else module.rpartition(".")[0]
    inner = any(is_package(other) and other.startswith(package + ".") for other in modules())
    return module if inner else package


def in_circles(graph):
    """What is left of a graph once all that leads nowhere has been taken away, again and again."""
    graph = {name: {other for other in to if other != name} for name, to in graph.items()}
    while leaves := [name for name, to in graph.items() if not to]:
        for leaf in leaves:
            del graph[leaf]
        for to in graph.values():
            to.difference_update(leaves)
    return graph


@pytest.mark.parametrize("module", [*modules()])
def test_a_module_imports_only_what_its_part_may(module):
    """Holds for lazy imports inside functions, too: a direction is a direction."""
    allowed = RULES[rule_of(module)] | (REGISTRIES if module == PACKAGE else set())
    assert offences(module, modules()[module], allowed) == []


@pytest.mark.parametrize(
    "module",
    [m for m in modules() if m.split(".")[0] in ("env", "lockstep") and not fits(m, VIEWS)],
)
def test_the_physics_and_the_link_know_no_views(module):
    if module != PACKAGE:
        assert not [name for name in names(module, modules()[module]) if fits(name, VIEWS)]


def test_the_physics_needs_nothing_but_numpy():
    hidden = ("gymnasium", "pettingzoo", "matplotlib", "torch", "flwr", "hydra", "omegaconf")
    program = (
        f"import sys; sys.modules.update(dict.fromkeys({hidden!r}))\n"
        f"import {', '.join(PHYSICS)}\n"
        "scenario = env.scenario.Scenario.drawn(env.config.EnvConfig(), 0)\n"
        "world = env.world.World(scenario, env.seeding.stream(0, env.seeding.Stream.WORLD))\n"
        "world.reset(); print(world.driving.all())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (done.stdout.strip(), done.stderr) == ("True", "")


@pytest.mark.parametrize(
    ("imported", "loaded"),
    [
        (
            [
                *OURS,
                "env.world",
                "lockstep.server",
                "storage.checkpoint_files",
                "conf.compose",
                "training.coordinator",
                "training.evaluation",
                "training.preflight",
                "training.resume",
                "training.recording.history",
                "training.run_folder",
            ],
            [],
        ),
        (["training.session", "training.controllers.schemes"], ["training.session: torch"]),
    ],
)
def test_importing_a_module_loads_no_heavy_library_that_it_does_not_need(imported, loaded):
    """One process imports them in turn, and says which was the first to load a library."""
    program = (
        "import sys, importlib; found = set()\n"
        f"for module in {imported!r}:\n"
        "    importlib.import_module(module)\n"
        f"    new = set({HEAVY!r}).intersection(sys.modules) - found; found |= new\n"
        "    new and print(f'{module}:', *sorted(new))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == loaded


def test_the_apps_and_the_command_are_where_the_rules_expect_them():
    assert {name.split(".")[0] for name in modules()} == set(OURS)
    assert {rule_of(name) for name in modules()} == {*RULES}


def test_modules_are_short():
    lines = sorted(
        len(path.read_text().splitlines()) for name in OURS for path in (ROOT / name).rglob("*.py")
    )
    assert lines[-1] < 300
    assert lines[len(lines) // 2] < 130


def test_no_module_imports_itself_through_others():
    """Imports made inside functions are left out: they run when both modules are whole."""
    graph = {
        module: {name for name in names(module, at_import_time(tree)) if name in modules()}
        for module, tree in modules().items()
    }
    assert in_circles(graph) == {}


def test_no_folder_imports_itself_through_others():
    """Imports made inside functions count; those for type checkers alone do not."""
    graph: dict[str, set[str]] = {folder(module): set() for module in modules()}
    for module, tree in modules().items():
        for name in names(module, tree, walk_what_runs):
            if name in modules():
                graph[folder(module)].add(folder(name))
    assert in_circles(graph) == {}


def walk_what_runs(tree):
    """A tree's nodes without what only type checkers read."""
    pending = [tree]
    while pending:
        node = pending.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        pending += ast.iter_child_nodes(node)


SAMPLES = [
    ("env.world", "import torch", ["torch"]),
    ("env.world", "import numpy as np\nimport math", []),
    ("env.world", "def f():\n    import flwr", ["flwr"]),
    ("env.world", "from matplotlib.figure import Figure", ["matplotlib.figure"]),
    ("env.world", "from storage import atomic", ["storage.atomic"]),
    ("env.rendering.drawing", "from matplotlib.figure import Figure", []),
    ("lockstep.frames", "from agent.config import AgentConfig", ["agent.config"]),
    ("lockstep.frames", "from . import messages\nfrom env import world", []),
    ("agent.agents.dqn", "from env.mdp import actions", ["env.mdp.actions"]),
    ("agent.agents.dqn", "from ..learning import losses\nfrom ...env import world", ["env.world"]),
    ("conf.schema", "from storage import atomic", ["storage.atomic"]),
    ("training.session", "from server_app.rounds import x", ["server_app.rounds"]),
    ("training.session", "from flwr.app import Context", ["flwr.app"]),
    ("training.aggregation.aggregator", "from flwr.app import Array", []),
    ("training.room_messages", "from flwr.app import Array", []),
    ("training.building", "from flwr.app import Array", ["flwr.app"]),
    ("training.recording.trackers.wandb", "import wandb", []),
    ("training.recording.recorder", "import wandb", ["wandb"]),
    ("client_app.app", "from server_app.rounds import x", ["server_app.rounds"]),
    ("server_app.app", "import torch", ["torch"]),
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


def test_folders_count_as_one_unless_folders_stand_beside_their_modules():
    assert folder("env.mdp.actions") == "env.mdp"
    assert folder("env.world") == "env.world"
    assert folder("lockstep.server") == "lockstep"
    assert in_circles({"a": {"b"}, "b": {"a", "c"}, "c": set()}) == {"a": {"b"}, "b": {"a"}}
