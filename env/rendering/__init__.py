"""Pictures of the floor, the radio map and robots' ways."""
