"""The report's words about ground: what the filter found, and what the seams between its blocks changed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fwclass.publish.sections import number, percent

FLAGS_LIMIT = {"ptd": 1e-3, "iptd": 1e-3}
"""Share of flags that may differ between blocks and one block; a TIN reaches further than a raster."""
RASTER_LIMIT = 1e-4
"""The same of raster filters."""
ERRORS = (("Type I (ground lost)", "type_i"), ("Type II (other taken)", "type_ii"), ("total", "total_error"))
CELLS_LIMIT = 1e-3
"""Share of terrain cells that may differ by more than a centimetre."""


def ground(facts: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Rows (what, figure) and sentences, or None without a ground filter."""
    if not facts or not facts.get("echoes"):
        return None
    echoes = facts["echoes"]
    rows = [
        ("filter", str(facts["method"])),
        *chosen_parameters(facts.get("auto")),
        ("ground", f"{number(facts['ground'])} echoes, {percent(facts['ground'] / echoes)} %"),
        ("noise", f"{number(facts['noise'])} echoes"),
        ("without terrain", f"{number(facts['without_terrain'])} echoes"),
    ]
    accuracy = facts.get("accuracy")
    if accuracy:
        rows.append(("against the reference", _errors(accuracy)))
    return {"rows": rows, "notes": _seams(facts)}


NAMED = 3
"""Squares that are named of those with the same parameters; `report.json` has all, with their bounds."""


def chosen_parameters(auto: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """Rows: which parameters were chosen, in how many squares, and by what evidence; nothing where none were."""
    by_choice: dict[str, list[Mapping[str, Any]]] = {}
    for square in auto["squares"] if auto else ():
        by_choice.setdefault(_choice(square), []).append(square)
    return [(f"in {_squares(some)}", f"{choice}; {_evidence(some)}") for choice, some in by_choice.items()]


def _choice(square: Mapping[str, Any]) -> str:
    chosen = square["parameters"]
    values = [f"{name} {value:g}" for name, value in chosen["values"].items()]
    words = ", ".join([str(chosen["method"]), *values, f"largest building {chosen['max_building_size']:g} m"])
    return words if square["evidence"] is not None else f"{words} as set, too few echoes to choose by"


def _squares(some: list[Mapping[str, Any]]) -> str:
    edge = some[0]["bounds"][2] - some[0]["bounds"][0]
    names = ", ".join(str(one["square"]) for one in some[:NAMED])
    more = f" and {len(some) - NAMED} more" if len(some) > NAMED else ""
    return f"{len(some)} square{'' if len(some) == 1 else 's'} of {edge:,.0f} m ({names}{more})"


def _evidence(some: list[Mapping[str, Any]]) -> str:
    known = [one["evidence"] for one in some if one["evidence"] is not None]
    cells = f"{sum(one['occupied'] for one in some):,} cells with an echo"
    if not known or known[0]["agreement"] is None:
        return cells
    now, before = ([one[name] for one in known] for name in ("agreement", "agreement_before"))
    return (
        f"{cells}; kappa with the referees {_span(now)}, with the first candidate {_span(before)}; "
        f"widest building {_span([one['building'] for one in known], 0)} m, "
        f"slope of nine tenths of the land below {_span([one['slope_steep'] for one in known])}"
    )


def _span(values: list[float], digits: int = 3) -> str:
    low, high = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
    return low if low == high else f"{low} to {high}"


def _errors(accuracy: Mapping[str, Any]) -> str:
    """Ground lost, other taken for ground, both, and kappa, of all echoes with a reference class."""
    parts = [f"{label} {percent(accuracy[key])} %" for label, key in ERRORS if accuracy.get(key) is not None]
    kappa = accuracy.get("kappa")
    return ", ".join([*parts, *([f"kappa {kappa:.3f}"] if kappa is not None else [])])


def _seams(facts: Mapping[str, Any]) -> list[str]:
    seams = facts.get("seams")
    if not seams:
        return ["The seams between blocks were not measured (run.seam_check_echoes is 0)."]
    left_out = seams.get("left_out", 0)
    if left_out and not seams["echoes"]:
        return ["The seams between blocks were not measured: no echo of the windows looked at is plausible."]
    share = seams["flags_differ"] / max(seams["echoes"], 1)
    across = seams.get("across")
    squares = "" if across is None else ", and in every square with parameters of its own apart"
    off = (seams["cells_off"] + seams["cells_one_sided"]) / max(seams["cells"], 1)
    notes = [
        f"The filter works in blocks of {facts['block']:g} m. Run once more in windows that lie "
        f"elsewhere{squares}, it changes {number(seams['flags_differ'])} flags ({100 * share:.4f} % of "
        f"{number(seams['echoes'])} echoes) and moves the terrain by more than {100 * seams['within']:g} cm in "
        f"{100 * off:.3f} % of the cells."
    ]
    if across is not None and across["echoes"]:
        differ = across["flags_differ"]
        notes.append(
            f"Within {across['width']:g} m of the borders of squares with other parameters lie "
            f"{number(across['echoes'])} echoes; {number(differ)} of them ({100 * differ / across['echoes']:.3f} %) "
            "would have another flag by the parameters of the other side."
        )
    if left_out:
        notes.append(
            f"{number(left_out)} echoes took no part: windows are drawn until they hold run.seam_check_echoes (a "
            "square metre counts as 3 at least), or 16 million cells of the terrain."
        )
    if share > FLAGS_LIMIT.get(facts["method"], RASTER_LIMIT) or off > CELLS_LIMIT:
        notes.append("That is more than it should be: choose larger blocks or a wider halo (ground.block, block_halo).")
    return notes
