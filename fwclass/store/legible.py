"""Files of the store that a library cannot make sense of."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fwclass.errors import FwclassError, StoreError


@contextmanager
def legible(path: Path, what: str) -> Iterator[None]:
    """`StoreError` where a library fails at reading `what` from `path`: of damaged bytes they raise anything."""
    try:
        yield
    except FwclassError:
        raise
    except Exception as fault:
        raise StoreError(
            f"{what} of the store cannot be read",
            where=path,
            got=f"{type(fault).__name__}: {fault}".splitlines()[0][:300],
            do="remove its part's directory and run again",
        ) from (None if isinstance(fault, MemoryError) else fault)
