"""The documents name functions, tests and keys that exist, and leave no key out."""

import ast
import re
from pkgutil import resolve_name

import pytest

from conf.overrides import FOLDER, all_keys

ROOT = FOLDER.parent
PACKAGES = (
    *("env", "agent", "storage", "repeatable", "lockstep"),
    *("conf", "training", "client_app", "server_app", "experiments"),
)
MODEL = (ROOT / "docs" / "model.md").read_text()
ASSUMPTIONS = (ROOT / "docs" / "assumptions.md").read_text()
OPEN_POINTS = [line for line in ASSUMPTIONS.splitlines() if line.startswith("| C-")]
ANOTHER_STRATEGY = "rooms.strategy."
"""A group with the keys of ``strategy``, whose rows say what they mean."""
WHERE_IT_RUNS = ("runtime.", "federation.link.", "run.", "state.")
HOW_FLOWER_CARRIES_IT = (
    "federation.windows_per_round",
    "federation.clients",
    "federation.on_loss",
    "federation.loss_timeout_s",
)


BASELINES = (ROOT / "docs" / "baselines.md").read_text()
KEYS = set(all_keys())


def functions(path):
    """Every class and function of a file, methods as ``Class.method``."""
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            yield node.name


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`((?:\w+/)+\w+\.py::\w+)`", MODEL))))
def test_a_test_that_the_model_names_exists(name):
    file, function = name.split("::")
    assert function in functions(ROOT / "tests" / file)


@pytest.mark.parametrize(
    "name",
    sorted(
        set(
            re.findall(
                r"`((?:env|agent|client_app|server_app|conf|training|lockstep|storage)\.[\w.]+)`",
                MODEL,
            )
        )
    ),
)
def test_a_function_that_the_model_names_exists(name):
    assert callable(resolve_name(name))


def test_the_model_has_a_row_for_every_numbered_equation():
    rows = "\n".join(line.split("|")[1] for line in MODEL.splitlines() if line.startswith("| ("))
    expected = {f"({n})" for n in (1, 2, 3, 4, *range(6, 13))} | {f"(5{c})" for c in "abcdefgh"}
    assert set(re.findall(r"\(\w+\)", rows)) == expected


def test_every_key_that_shapes_a_result_is_an_assumption_and_every_key_named_exists():
    named = {
        key for row in OPEN_POINTS for key in re.findall(r"`([a-z_.0-9]+)`", row) if key in KEYS
    }
    dotted = {
        key for row in OPEN_POINTS for key in re.findall(r"`((?:env|agent)\.[a-z_.0-9]+)`", row)
    }
    left_out = {
        key
        for key in KEYS
        if not key.startswith(WHERE_IT_RUNS) and key not in (*HOW_FLOWER_CARRIES_IT, "env.robots")
    }
    left_out -= {
        key
        for key in left_out
        if key.startswith(ANOTHER_STRATEGY) and key.removeprefix("rooms.") in named
    }
    assert dotted <= KEYS
    assert left_out - named == set()


def test_assumptions_have_ids_of_their_own_and_the_code_cites_no_other():
    ids = [row.split("|")[1].strip() for row in OPEN_POINTS]
    assert len(ids) == len({*ids})
    cited = {
        found
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        for found in re.findall(r"\bC-[A-Z]{2,}\b", path.read_text())
    }
    assert "C-PHASE" in cited
    assert cited <= {*ids}


def test_every_baseline_has_a_row_and_every_row_a_baseline():
    rows = re.findall(r"^\| `baseline=(\w+)", BASELINES, re.MULTILINE)
    assert sorted(rows) == sorted(path.stem for path in FOLDER.glob("baseline/*.yaml"))
