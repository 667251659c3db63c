"""What of a reproduction is kept in ``results/``."""
