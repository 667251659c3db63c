"""What is Flower's on a client: the ClientApp, robots and their state."""
