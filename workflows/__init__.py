"""One file per workflow: which stages, in which order; composition only."""

from __future__ import annotations

from workflows.classification import classification
from workflows.fan2013 import fan2013
from workflows.xiong2018 import xiong2018

WORKFLOWS = {"classification": classification, "fan2013": fan2013, "xiong2018": xiong2018}
"""Workflows by the name that `fwclass run --workflow` takes."""
