"""The lockstep link between the world and the robots' clients: calls, or frames over TCP."""
