"""Federated aggregation: Flower's strategies over rows of weights."""
