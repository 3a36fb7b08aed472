"""Whether the files of finished parts still have the bytes that were written: all of them are read."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fwclass.run.status.look import Looked
from fwclass.store.url import Url


@dataclass(frozen=True)
class Damage:
    """Files of one part that are not what was written, by their names in the part."""

    stage: str
    part: str
    files: tuple[str, ...]

    def as_data(self) -> dict[str, Any]:
        return {"stage": self.stage, "part": self.part, "files": list(self.files)}


def damages(looked: Looked) -> list[Damage]:
    """Every part counted as done that is damaged."""
    store, found = looked.store, []
    for state in looked.states.values():
        receipt = store.receipt(state.stage, state.part) if state.standing == "done" else None
        files = store.damaged(receipt) if receipt is not None else []
        if files:
            found.append(Damage(state.stage, state.part, tuple(files)))
    return found


def as_text(found: list[Damage], where: Path | Url) -> str:
    """One line for each damaged part, and what to do."""
    if not found:
        return "all files of all parts that are done have the bytes that were written"
    rows = [f"damaged  {d.stage}/{d.part}: {', '.join(d.files)}" for d in found]
    places = [shlex.quote(str(where / "store" / d.stage / d.part)) for d in found]
    if isinstance(where, Url):
        how = "to have them made again, remove all objects below these addresses, and run again:"
        return "\n".join([*rows, how, *(f"{p}/" for p in places)])
    return "\n".join([*rows, "to have them made again, remove them and run again: rm -r " + " ".join(places)])
