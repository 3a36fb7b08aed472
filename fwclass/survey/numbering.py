"""Numbers of source files that stay when others come and go: a function of the names, not of the list."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable

from fwclass.errors import InputError

NUMBERS = 65_521
"""Numbers there are; the largest prime that fits the sixteen bits of an echo's strip."""

_DIGITS = re.compile(r"\d+")
_COUNTED = "strip_#"
"""Files named like this are numbered just as they say: strip_07 is strip 7."""


def assign_numbers(names: Iterable[str]) -> dict[str, int]:
    """A number of its own for every name, in [0, 65521).

    Names that differ only in their digits follow each other as the digits do (line_1203 comes right after line_1202).
    The number of a name changes with the list only where two names want the same one: the one with the smaller hash has
    it, the other takes its next choice. That befalls one added file in 65521 / n.

    `InputError`: there are more names than numbers.
    """
    waiting = sorted(set(names), key=_hash)
    if len(waiting) > NUMBERS:
        raise InputError(
            "too many source files for one survey",
            where="survey.sources",
            expected=f"at most {NUMBERS:,}",
            got=f"{len(waiting):,}",
            do="classify it in several pieces",
        )
    numbered: dict[str, int] = {}
    used: set[int] = set()
    for name in waiting:
        choice, tries = _first_choice(name), 0
        while choice in used:
            tries += 1
            choice = (_hash(f"{name}/{tries}") if tries < NUMBERS else choice + 1) % NUMBERS
        numbered[name] = choice
        used.add(choice)
    return numbered


def _first_choice(name: str) -> int:
    """The name's digits, read as one number, moved by what stands around them."""
    digits = "".join(_DIGITS.findall(name))
    return (int(digits or "0") + _hash(_DIGITS.sub("#", name)) - _hash(_COUNTED)) % NUMBERS


def _hash(text: str) -> int:
    return int.from_bytes(hashlib.blake2b(text.encode("utf-8", "surrogatepass"), digest_size=8).digest(), "little")
