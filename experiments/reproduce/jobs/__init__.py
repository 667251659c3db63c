"""Training what a target needs."""
