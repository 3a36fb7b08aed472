"""SQLite files that anyone may have made: opened so that looking costs in proportion to them, and asked for what would
compute, or give more than they hold, while they are read."""

from __future__ import annotations

import re
import sqlite3
from functools import partial
from pathlib import Path

from fwclass.errors import visible

SIGNATURE = b"SQLite format 3\0"

MOST_DEFAULTS = 512
"""Bytes of the values that the columns of a table have where a row is silent: rows of a few bytes may have them all."""

STEPS = 100
"""Instructions of SQLite's machine for a byte of the file at most, and `FEWEST_STEPS` more; looking takes some 10."""
FEWEST_STEPS = 100_000_000

_GLANCE = 1_000_000


def open_sqlite(path: Path, live: bool = False) -> sqlite3.Connection:
    """The database, to be read; with its write-ahead log if `live`. Ends in `sqlite3.OperationalError` where a question
    takes much longer than the file is large; texts that are none are given with marks in their place."""
    more = "" if live else "&immutable=1"
    opened = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro{more}", uri=True)
    opened.text_factory = partial(str, encoding="utf-8", errors="replace")
    left = [FEWEST_STEPS + STEPS * path.stat().st_size]

    def enough() -> bool:
        left[0] -= _GLANCE
        return left[0] < 0

    opened.set_progress_handler(enough, _GLANCE)
    opened.execute("PRAGMA trusted_schema = OFF")
    opened.execute("PRAGMA ignore_check_constraints = ON")  # which would compute while pages are checked
    return opened


def schema_fault(opened: sqlite3.Connection) -> str:
    """What would compute while it is read, or give more than is there: a view, generated columns, long values of silent
    columns; "" for none. Views that no table knows count too: GDAL looks into all."""
    for (name,) in opened.execute("SELECT name FROM sqlite_master WHERE type = 'view' LIMIT 1"):
        return f"a view, {visible(str(name))}, which is computed when it is read"
    columns = (
        "SELECT m.name, max(x.hidden IN (2, 3)), total(length(CAST(x.dflt_value AS BLOB))) "
        "FROM sqlite_master AS m, pragma_table_xinfo(m.name) AS x WHERE m.type = 'table' GROUP BY m.name"
    )
    for name, generated, defaults in opened.execute(columns):
        if generated:
            return f"generated columns in {visible(str(name))}, which are computed when it is read"
        if defaults > MOST_DEFAULTS:
            return f"a value of {defaults:.0f} bytes for silent rows of {visible(str(name))}, which all have it"
    return ""


def page_fault(opened: sqlite3.Connection) -> str:
    """That pages do not make trees, "" if they do: one that is there twice would be walked without end."""
    for (said,) in opened.execute("PRAGMA quick_check(100)"):
        if re.search(r"page|tree|malformed", str(said), re.IGNORECASE):
            return f"a damaged database ({visible(' '.join(str(said).split()))[:80]})"
    return ""
