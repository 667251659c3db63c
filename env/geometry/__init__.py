"""The floor: cells, walls, plans and distances."""
