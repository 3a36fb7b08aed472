"""Parts of a run that were made with other libraries than those here: how many, and what is told of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from fwclass.errors import several
from fwclass.run.runner import Runner
from fwclass.store.libraries import fingerprint, stale_by
from fwclass.store.receipts import Receipt
from fwclass.store.run_store import Store


def by_change(receipts: Iterable[Receipt], store: Store) -> tuple[Counter[str], int]:
    """Parts by how their libraries differ from those here (``pyarrow 26.0.1 to 22.0.0``), and how many do not tell."""
    parts: Counter[str] = Counter()
    unknown = 0
    for receipt in receipts:
        then = store.provenance.libraries(receipt)
        unknown += then is None
        parts[", ".join(stale_by(then))] += 1
    parts.pop("", None)
    return parts, unknown


def library_remarks(store: Store, accepted: bool) -> list[str]:
    """What a run says at its beginning of parts that others made, a line for each set of libraries.

    Receipts are read only where some run in this store had other libraries.
    """
    prints = store.provenance.fingerprints()
    names = store.parts() if any(map(stale_by, prints)) or not prints else []
    if not names:
        return []
    store.look_up(names)
    changes, unknown = by_change((r for r in (store.receipt(*n) for n in names) if r is not None), store)
    lines = ["earlier parts of this run do not tell the libraries that they were made with; they count as done"]
    what = "they count as done, as asked" if accepted else "they are made again (--accept-libraries keeps them)"
    changed = [f"{n} parts were made with other libraries ({change}): {what}" for change, n in changes.items()]
    return changed + (lines if unknown and not prints else [])


def report_libraries(runner: Runner) -> dict[str, Any]:
    """What the report says: the libraries here, parts made with others that count as done, and parts that do not
    tell."""
    receipts = (runner.store.receipt(*name) for name, outcome in runner.outcomes.items() if outcome.ok)
    changes, unknown = by_change((r for r in receipts if r is not None), runner.store)
    return {"here": dict(fingerprint()), "accepted": dict(changes), "unknown": unknown}


def by_libraries(parts: Mapping[str, int], store: Store) -> list[dict[str, Any]]:
    """For `fwclass status`: parts by what they were made with, as plain data; `parts` counts receipts' `libraries`."""
    rows = []
    for digest, count in parts.items():
        then = store.provenance.fingerprint(digest)
        rows.append({"parts": count, "made_with": None if then is None else dict(then), "changes": stale_by(then)})
    return rows


def text_of(row: Mapping[str, Any]) -> str:
    """A row of `by_libraries` as a line."""
    then, here = row["made_with"], fingerprint()
    parts = several(row["parts"], "part")
    if then is None:
        return f"{parts} without a word on the libraries that made them, counted as done"
    if not then:
        return f"{parts}: {row['changes'][0]}"
    same = all(then.get(n) == here[n] for n in ("fwclass", "source"))
    program = f"fwclass {then.get('fwclass')}, source {then.get('source')}{' (as here)' if same else ''}"
    if not same:
        program += f", not {here['fwclass']}, source {here['source']}"
    changes = f"; {', '.join(row['changes'])}" if row["changes"] else "; the same libraries as here"
    return f"{parts} made by {program}{changes}"
