"""The report's words about echoes beside the returns of their strip."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fwclass.publish.sections import measure, number, percent

COUNTED = ("unexplained", "outside", "below", "weak", "implausible", "returns_without_echo")
"""Counts of a strip that the table shows beside its echoes."""


def plausibility(facts: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """One row for every strip with waveforms; None without any."""
    if not facts or not facts.get("strips"):
        return None
    rows = [
        {
            "name": strip["name"],
            "fitted": number(strip["fitted"]),
            "cells": [number(strip[name]) for name in COUNTED],
            "share": percent(strip["implausible_share"]) or "–",
            "lag1": measure(strip["lag1"]),
            "inflation": measure(strip["inflation"]),
        }
        for strip in facts["strips"]
    ]
    return {"rows": rows, "accepted": bool(facts.get("accepted")) and bool(facts.get("remarks"))}
