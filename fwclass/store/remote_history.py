"""The history of a run on object storage: nothing can be appended there, so every line is an object,
``store/history/<when the run began>-<id>-<record>.json``; a list of names is in the order of the runs' beginnings, by
the second and by the clock of the host that ran them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

from fwclass.store.lock import SCHEDULE, WRITER
from fwclass.store.objects import Objects
from fwclass.store.remote_lock import key_of

BELOW = "store/history"
RECORDS = ("begin", "end", "told")
KEPT = 5000
"""Runs that stay, as many as in a directory; who next holds the run's lock removes the oldest beyond."""
LAST = 200
"""Runs that are read where nobody says how many: each is an object or two."""

_NAME = re.compile(rf"{BELOW}/(?P<began>\d{{8}}T\d{{6}}Z)-(?P<id>\w+)-(?P<record>{'|'.join(RECORDS)})\.json", re.ASCII)


def append(objects: Objects, line: Mapping[str, Any]) -> None:
    """Put a line; `StoreError` where it cannot be written."""
    objects.put(_key(line), json.dumps(line, sort_keys=True, allow_nan=False).encode())


def lines(objects: Objects, last: int) -> Iterator[dict[str, Any]]:
    """The lines of the `last` runs, those of the oldest first; the beginning of one that has ended is left out."""
    runs = list(_by_run(held.key for held in objects.list(BELOW)).values())[-last:]
    yield from _read(objects, [key for keys in runs for key in keys])


def lines_of(objects: Objects, name: str) -> Iterator[dict[str, Any]]:
    """The lines of the run whose id is `name`."""
    yield from _read(objects, _by_run(held.key for held in objects.list(BELOW)).get(_word(name), []))


def is_run(objects: Objects) -> bool:
    """Somebody has taken a lock there."""
    return any(found is not None for found in objects.many([key_of(WRITER), key_of(SCHEDULE)]))


def surplus(keys: Iterable[str]) -> list[str]:
    """Which of `keys` are lines of runs that have been there for too long."""
    runs = list(_by_run(keys, whole=True).values())
    return [key for some in runs[: max(0, len(runs) - KEPT)] for key in some]


def _key(line: Mapping[str, Any]) -> str:
    began = str(line.get("began") or datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"))
    return f"{BELOW}/{re.sub('[-:]', '', began)}-{_word(str(line['id']))}-{line['record']}.json"


def _word(name: str) -> str:
    """An id as a part of a name: it may come from the environment."""
    return re.sub(r"[^0-9A-Za-z]", "_", name)[:100] or "_"


def _by_run(keys: Iterable[str], whole: bool = False) -> dict[str, list[str]]:
    """Names of lines by the run's id, in the order of the runs' beginnings; what is no line is passed over.

    Not `whole`: without a beginning whose run has ended, because the end repeats all of it.
    """
    runs: dict[str, dict[str, str]] = {}
    for match in filter(None, map(_NAME.fullmatch, sorted(keys))):
        runs.setdefault(match["id"], {})[match[0]] = match["record"]
    return {name: _in_order(records, whole) for name, records in runs.items()}


def _in_order(records: Mapping[str, str], whole: bool) -> list[str]:
    """Names of one run's lines, as they were written; `records`: what each is."""
    needed = [key for key, record in records.items() if whole or record != "begin" or "end" not in records.values()]
    return sorted(needed, key=lambda key: RECORDS.index(records[key]))


def _read(objects: Objects, keys: Iterable[str]) -> Iterator[dict[str, Any]]:
    """The lines that are there and are whole."""
    for data in objects.many(list(keys)):
        try:
            found = json.loads(data[0]) if data is not None else None
        except (ValueError, RecursionError):
            continue
        if isinstance(found, dict):
            yield found
