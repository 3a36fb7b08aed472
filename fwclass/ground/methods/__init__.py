"""Ground filters, and what several of them share; two are made of others (csf+smrf, consensus)."""

from __future__ import annotations

from typing import Literal

Method = Literal["slope", "pmf", "smrf", "moving-surface", "ptd", "iptd", "csf", "csf+smrf", "consensus"]
"""Ground filters by the names of the command line."""
