"""What the learner takes from torch that torch does not promise to keep."""

import ast
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).parent.parent.parent
PACKAGES = (
    "env", "storage", "repeatable", "agent", "lockstep", "conf", "training", "client_app",
    "server_app", "experiments",
)  # fmt: skip
TRIED = ("2.13.0",)
"""Versions of torch with which all tests passed."""
PRIVATE = {"_fused_adam_"}
"""Functions of torch whose names begin with an underscore."""
ARGUMENTS = [
    "self", "grads", "exp_avgs", "exp_avg_sqs", "max_exp_avg_sqs", "state_steps", "lr", "beta1",
    "beta2", "weight_decay", "eps", "amsgrad", "maximize",
]  # fmt: skip
"""What ``Learner._adam`` gives to it, in this order and under these names."""

SAY = f"torch {torch.__version__} (tried: {', '.join(TRIED)})"


@pytest.mark.parametrize("name", sorted(PRIVATE))
def test_torch_has_the_private_functions_that_learning_needs(name: str) -> None:
    assert hasattr(torch, name), (
        f"{SAY} has no torch.{name}, which agent/learning/learner.py calls:"
        " install a version that was tried, or find what has replaced it"
    )


def test_fused_adam_takes_what_the_learner_gives_it() -> None:
    schema = torch.ops.aten._fused_adam_.default._schema
    found = [argument.name for argument in schema.arguments]
    assert found[: len(ARGUMENTS)] == ARGUMENTS, f"{SAY}: torch._fused_adam_ takes {found}"
    assert all(argument.has_default_value() for argument in schema.arguments[len(ARGUMENTS) :]), (
        f"{SAY}: torch._fused_adam_ needs more than the learner gives it: {found}"
    )


def test_no_other_private_function_of_torch_is_called() -> None:
    found = {
        node.attr
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute)
        and node.attr.startswith("_")
        and not node.attr.startswith("__")
        and ast.unparse(node.value).split(".")[0] == "torch"
    }
    assert found == PRIVATE
