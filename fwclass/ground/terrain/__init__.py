"""Terrain and surface models, and heights above ground."""
