"""What happens to weights on their way between robots and server."""
