"""Whether the amplitudes and echo widths of a survey are the quantities that its classifier decides by."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from fwclass.errors import ConfigError, first_few
from fwclass.features.names import FeatureRequest, is_feature
from fwclass.radiometry.stage import RADIOMETRY
from fwclass.read.quantities import COUNTS, FITTED, READ, STEPS, Quantities, unit_of, words_of

_AMPLITUDE = ("amplitude", "amplitude_sigma", "energy", *RADIOMETRY.writes)
_STEPPED = ("amplitude", "amplitude_sigma")
"""Of these, what is counted in steps of the samples; energies are in the samples' own unit."""

_WIDTH = ("width", "width_sigma")
_LISTED = 3

By = dict[str, dict[str, str]]
"""For every feature that depends on one: what of (``amplitude``, ``width``), its ``quantity`` and ``unit``."""


def quantities_by_feature(names: Iterable[str], quantities: Quantities) -> By:
    """For a model's card: the quantity that every one of its features is made of; features of neither are left out."""
    by_feature: By = {}
    for name in names:
        kind = quantity_of_feature(name)
        if kind:
            quantity = str(getattr(quantities, kind))
            by_feature[name] = {"of": kind, "quantity": quantity, "unit": unit_of(quantity)}
    return by_feature


def quantity_of_feature(name: str) -> str:
    """``amplitude``, ``width`` or "": what a feature or column is made of."""
    reads = FeatureRequest.of([name]).reads if is_feature(name) else (name,)
    if any(column in _AMPLITUDE for column in reads):
        return "amplitude"
    return "width" if any(column in _WIDTH for column in reads) else ""


def _another(name: str, one: str, other: str) -> bool:
    """Feature or column `name` means another thing where amplitudes are `other` than where they are `one`."""
    if one == other or quantity_of_feature(name) != "amplitude":
        return False
    if all(q == COUNTS or q.startswith(STEPS) for q in (one, other)):
        return any(c in _STEPPED for c in (FeatureRequest.of([name]).reads if is_feature(name) else (name,)))
    return True


def joint_quantities(files: Mapping[str, Quantities], names: Iterable[str], where: object) -> Quantities:
    """What the amplitudes and widths of a survey's files are; `ConfigError` where amplitudes differ and one of the
    features `names` is made of them. Where none is, those of the first file."""
    first, quantities = next(iter(files.items()))
    names, mixed = tuple(names), [(f, q.amplitude) for f, q in files.items() if q.amplitude != quantities.amplitude]
    for other, kind in mixed:
        hang = [n for n in names if _another(n, quantities.amplitude, kind)]
        if not hang:
            continue
        one_step = STEPS in kind + quantities.amplitude
        raise ConfigError(
            f"the files have different kinds of amplitudes, and {first_few(hang, _LISTED)} would mix them",
            where=where,
            expected="one kind in all files",
            got=f"{first}: {words_of(quantities.amplitude)}; {other}: {words_of(files[other].amplitude)}",
            do="give all files the same `step` in their metadata, or take features of energy (survey.features)"
            if one_step
            else "take them apart into surveys of one kind, or leave these features out (survey.features)",
        )
    return quantities


def mixed_note(files: Mapping[str, Quantities]) -> list[str]:
    """That files count their amplitudes differently, for echoes that are delivered with them."""
    kinds: dict[str, str] = {}
    for name, quantities in files.items():
        kinds.setdefault(quantities.amplitude, name)
    if len(kinds) < 2:
        return []
    each = first_few([f"{name}: {words_of(kind)}" for kind, name in kinds.items()], _LISTED)
    return [f"amplitudes are not the same quantity in all files ({each}): only energies can be compared"]


def check_learned(card: Mapping[str, Any], files: Mapping[str, Quantities], where: object) -> list[str]:
    """Notes; `ConfigError` where a model decides by another quantity than a file has.

    An echo width that was fitted and one that the vendor gives are the same quantity, in ns, and only noted; so is a
    card of an earlier version that does not say what it learned.
    """
    learned: Any = card.get("computed", {}).get("quantities")
    if not isinstance(learned, Mapping) or not all(isinstance(one, Mapping) for one in learned.values()):
        hang = [n for n in card["features"] if quantity_of_feature(n)]
        if not hang or not files:
            return []
        kinds = sorted({words_of(q.amplitude) for q in files.values()})
        return [
            f"the model's card does not say which quantity {first_few(hang, _LISTED)} {_are(hang)} made of; "
            f"here amplitudes are {' and '.join(kinds)}: train it again to be sure"
        ]
    notes = []
    for kind in ("amplitude", "width"):
        quantity_of = {n: str(one.get("quantity")) for n, one in learned.items() if one.get("of") == kind}
        for name, quantities in files.items():
            got = getattr(quantities, kind)
            other = [n for n, q in quantity_of.items() if (q != got if kind == "width" else _another(n, q, got))]
            if not other:
                continue
            theirs = quantity_of[other[0]]
            if {theirs, got} == {FITTED, READ}:
                notes.append(f"the model learned echo widths {words_of(theirs)}; those of {name} are {words_of(got)}")
                continue
            raise ConfigError(
                f"the model learned from another {'amplitude' if kind == 'amplitude' else 'echo width'}",
                where=where,
                expected=f"{words_of(theirs)}, which {first_few(other, _LISTED)} {_are(other)} made of",
                got=f"{name}: {words_of(got)}",
                do="use a model that was trained on such data, or train one without these features",
            )
    return list(dict.fromkeys(notes))


def _are(names: list[str]) -> str:
    return "is" if len(names) == 1 else "are"
