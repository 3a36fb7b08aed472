"""Delaunay triangulation and linear interpolation on it."""
