"""Launchers of Flower's runtimes: what they start ends with them."""
