"""What is Flower's on the server: the ServerApp, rounds, clients and lost ones."""
