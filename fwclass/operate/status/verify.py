"""Whether all files still have the bytes that were written: those of finished parts, and of every generation. All of
them are read.

A part that was made from a damaged one may be wrong, though its own bytes are what was written: nothing tells whether
it was made before the damage or after. So every part whose receipt names a damaged one among its inputs goes with it,
and what names that, and so on. What was sound comes out as it was.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from fwclass.operate.request import Request
from fwclass.run.part import Name
from fwclass.store.receipts import Receipt
from fwclass.store.run_store import Store

SOUND = "all files of all parts, and of all that was delivered, have the bytes that were written"

LISTED = 100
"""Damaged files of a generation that are named; the others are counted."""


@dataclass(frozen=True)
class Damage:
    """Files of one part that are not what was written, by their names in the part."""

    stage: str
    part: str
    files: tuple[str, ...]

    @property
    def name(self) -> Name:
        """Stage and part."""
        return self.stage, self.part

    def as_data(self) -> dict[str, Any]:
        """As plain data."""
        return {"stage": self.stage, "part": self.part, "files": list(self.files)}


@dataclass(frozen=True)
class Verification:
    """What is not as it was written: `parts`; `descendants` made from them; files that were `delivered`, by the name of
    their generation, of which readers see the one that is `shown`; names in the run directory that lead readers
    `astray`, being no links to it."""

    parts: tuple[Damage, ...]
    descendants: tuple[Name, ...]
    delivered: Mapping[str, tuple[str, ...]]
    shown: str
    astray: tuple[str, ...] = ()

    @property
    def sound(self) -> bool:
        """Nothing is damaged."""
        return not (self.parts or self.delivered or self.astray)

    @property
    def earlier(self) -> tuple[str, ...]:
        """Damaged generations that no run makes again."""
        return tuple(name for name in self.delivered if name != self.shown)

    def as_data(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "damaged": [d.as_data() for d in self.parts],
            "made_from_damaged": [{"stage": stage, "part": part} for stage, part in self.descendants],
            "damaged_delivered": [f"{of}/{name}" for of, names in self.delivered.items() for name in names],
            "astray": list(self.astray),
        }


def verify(store: Store) -> Verification:
    """Read every file of every part that has a receipt, in the plan or not, and of every generation."""
    damaged = []
    for receipt in _receipts(store):
        files = store.damaged(receipt)
        if files:
            damaged.append(Damage(receipt.stage, receipt.part, tuple(files)))
    delivered = {name: tuple(files) for name, files in store.generations.damage().items()}
    pointer = store.generations.files.pointer()
    shown = pointer[0] if pointer else ""
    astray = store.generations.files.astray(shown) if shown else ("current",) if pointer else ()
    made_from = _descendants({d.name for d in damaged}, store)
    return Verification(tuple(damaged), made_from, delivered, shown, astray)


def remove(verified: Verification, store: Store) -> None:
    """Remove damaged parts and all that was made from them, for the holder of the run's lock."""
    store.remove_all(verified.descendants)  # until the damaged ones are gone, all that was made of them is known
    store.remove_all(d.name for d in verified.parts)


def _receipts(store: Store) -> Iterator[Receipt]:
    names = store.parts()
    store.look_up(names)
    for name in names:
        receipt = store.receipt(*name)
        if receipt is not None:
            yield receipt


def _descendants(damaged: set[Name], store: Store) -> tuple[Name, ...]:
    """Parts that were made from `damaged` ones, and from those that were, the last made first."""
    bad, steps = set(damaged), []
    while damaged:
        damaged = {
            (r.stage, r.part)
            for r in _receipts(store)
            if (r.stage, r.part) not in bad and any(_part_of(name) in bad for name in r.inputs)
        }
        bad |= damaged
        steps.append(sorted(damaged))
    return tuple(name for step in reversed(steps) for name in step)


def _part_of(name: str) -> Name:
    """The part that an input's name means; files from outside have names that no part has."""
    stage, _, part = name.partition("/")
    return stage, part


def rows(verified: Verification) -> list[str]:
    """What is damaged, and what was made from it, in lines."""
    lines = [f"damaged  {d.stage}/{d.part}: {', '.join(d.files)}" for d in verified.parts]
    counts = Counter(stage for stage, _ in verified.descendants)
    if counts:
        lines.append(f"made from these: {', '.join(f'{stage} {n}' for stage, n in sorted(counts.items()))}")
    for generation, files in verified.delivered.items():
        where = f"generations/{generation}"
        lines += [f"damaged  {where}/{name}" for name in files[:LISTED]]
        if len(files) > LISTED:
            lines.append(f"         and {len(files) - LISTED} more files of {where}")
    lines += [
        f"astray   {name} is no link to the delivery that is shown: readers see something else"
        for name in verified.astray
    ]
    return lines


def earlier_advice(verified: Verification, root: str) -> list[str]:
    """What to do about damaged generations that no run makes again, if there are any."""
    if not verified.earlier:
        return []
    names = ", ".join(verified.earlier)
    remove = shlex.join(["fwclass", "clean", root, "--keep", "latest"])
    return [f"earlier deliveries are not made again ({names}): copy what you need of them; to remove them: {remove}"]


def as_text(verified: Verification, request: Request) -> str:
    """What is damaged, what was made from it, and what to do."""
    if verified.sound:
        return SOUND
    lines = [*rows(verified), *earlier_advice(verified, str(request.root))]
    if verified.astray:
        lines.append("move away what stands in the place of these links; the next run makes them")
    if verified.parts or verified.shown in verified.delivered or verified.astray:
        lines.append(f"to have all of it made again, and delivered: {request.command()} --verify")
    return "\n".join(lines)
