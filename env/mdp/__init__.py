"""Actions, observations, rewards, starts, destinations and collisions."""
