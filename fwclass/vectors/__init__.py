"""Outlines of buildings, and tops and crowns of trees, from classified echoes."""
