"""Transitions as packed rows: uniform, prioritised, and over several slots."""
