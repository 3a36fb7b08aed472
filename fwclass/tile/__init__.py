"""Echoes of strips in the tiles of the global grid, and which of them are there twice."""
