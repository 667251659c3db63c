"""Losses, gradients by hand, and the learner of stacked agents."""
