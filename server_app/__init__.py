"""The server's side: ServerApp, access point, coordinator, strategies, evaluation, run folder."""

from server_app.app import app

__all__ = ["app"]
