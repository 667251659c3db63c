"""The world behind the interfaces of Gymnasium and PettingZoo."""
