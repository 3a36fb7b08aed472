"""One file per workflow: which stages, in which order; composition only."""

from __future__ import annotations

from workflows.classification import classification

WORKFLOWS = {"classification": classification}
"""Workflows by the name that `fwclass run --workflow` takes."""
