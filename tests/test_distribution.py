"""What is shipped: all packages, each with its types; every check knows the same ones."""

import re
import tomllib
from pathlib import Path

import yaml  # type: ignore[import-untyped]

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
MAKEFILE = (ROOT / "Makefile").read_text()
SHIPPED = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]


def test_every_package_that_is_shipped_says_that_it_has_types():
    assert [name for name in SHIPPED if not (ROOT / name / "py.typed").is_file()] == []


def test_the_wheel_the_type_checker_and_make_know_the_same_packages():
    assert PROJECT["tool"]["mypy"]["files"][: len(SHIPPED)] == SHIPPED
    assert re.search(r"^PACKAGES := (.*)$", MAKEFILE, re.M)[1].split() == SHIPPED


def test_a_commit_is_checked_by_what_make_lint_runs():
    (local,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    parts = re.search(r"^lint: (.*)$", MAKEFILE, re.M)[1].split()
    assert local["repo"] == "local"
    assert [hook["entry"].split()[-1] for hook in local["hooks"]] == parts
    assert {hook["language"] for hook in local["hooks"]} == {"system"}
