"""Ground filters, one a file, with what several of them share."""

from __future__ import annotations

from typing import Literal

Method = Literal["slope", "pmf", "smrf", "moving-surface", "ptd", "iptd", "csf", "csf+smrf", "consensus"]
"""Ground filters by the names of the command line."""
