"""What is worked out from runs."""
