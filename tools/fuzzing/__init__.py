"""Fuzzers that coverage guides."""
