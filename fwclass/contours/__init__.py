"""Contour lines of the terrain: pieces by blocks, smoothed and joined."""
