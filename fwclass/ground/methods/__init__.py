"""Ground filters, and what several of them share; two are made of others (csf+smrf, consensus)."""

from __future__ import annotations

from typing import Literal

Voter = Literal["slope", "pmf", "smrf", "moving-surface", "ptd", "iptd", "csf", "csf+smrf"]
"""Ground filters that a consensus may ask, by the names of the command line."""

Method = Literal[Voter, "consensus"]
"""All ground filters."""
