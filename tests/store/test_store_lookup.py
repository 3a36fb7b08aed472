"""Receipts that a process remembers are bounded in bytes, and never stand for a file that looks otherwise."""

from __future__ import annotations

from fwclass.store import lookup
from fwclass.store.lookup import _Remembered
from fwclass.store.objects import Mark


def test_those_that_were_kept_longest_go(monkeypatch):
    monkeypatch.setattr(lookup, "REMEMBERED", 1000)
    held = _Remembered()
    for k in range(50):
        held.keep(f"{k}", (300, k, k), (None, Mark(f"{k}")))
    assert [k for k in range(50) if held.get(f"{k}", (300, k, k))] == [47, 48, 49]
    held.keep("48", (900, 1, 1), (None, Mark("new")))
    assert held.get("48", (900, 1, 1)) == (None, Mark("new"))
    assert held.get("48", (300, 48, 48)) is None and held.get("49", (300, 49, 49)) is None
    held.keep("large", (5000, 0, 0), (None, Mark(None)))  # one that is too large by itself is kept until the next
    assert held.get("large", (5000, 0, 0)) is not None and held.get("48", (900, 1, 1)) is None
    held.keep("49", (10, 0, 0), (None, Mark(None)))
    assert held.get("large", (5000, 0, 0)) is None and held.get("49", (10, 0, 0)) is not None
