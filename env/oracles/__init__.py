"""What is best in a slot and over an episode."""
