"""The client's side: ClientApp, robots and their state."""

from client_app.app import app

__all__ = ["app"]
