"""Distances of a hand from object, table, obstacles and itself, and where its pads touch."""
