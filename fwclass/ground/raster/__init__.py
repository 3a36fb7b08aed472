"""Rasters of heights: lowest points, openings, filling, values at points."""
