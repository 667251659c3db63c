"""Fixtures of the commands' tests."""

from train_helpers import start

__all__ = ["start"]
