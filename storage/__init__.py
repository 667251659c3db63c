"""What is on disk: atomic writes, checkpoint files and their layout, generators' states."""
