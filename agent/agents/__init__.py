"""Agents that act, learn, save and go on."""
