"""The report's words about ground: what the filter found, and what the seams between its blocks changed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fwclass.publish.sections import number, percent

FLAGS_LIMIT = {"ptd": 1e-3, "iptd": 1e-3}
"""Share of flags that may differ between blocks and one block; a TIN reaches further than a raster."""
RASTER_LIMIT = 1e-4
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
        ("ground", f"{number(facts['ground'])} echoes, {percent(facts['ground'] / echoes)} %"),
        ("noise", f"{number(facts['noise'])} echoes"),
        ("without terrain", f"{number(facts['without_terrain'])} echoes"),
    ]
    accuracy = facts.get("accuracy")
    if accuracy:
        rows.append(("against the reference", _errors(accuracy)))
    return {"rows": rows, "notes": _seams(facts)}


def _errors(accuracy: Mapping[str, Any]) -> str:
    """Ground lost, other taken for ground, both, and kappa, of all echoes with a reference class."""
    parts = [f"{label} {percent(accuracy[key])} %" for label, key in ERRORS if accuracy.get(key) is not None]
    kappa = accuracy.get("kappa")
    return ", ".join([*parts, *([f"kappa {kappa:.3f}"] if kappa is not None else [])])


def _seams(facts: Mapping[str, Any]) -> list[str]:
    seams = facts.get("seams")
    if not seams:
        return ["The seams between blocks were not measured: the survey is larger than run.seam_check_echoes."]
    left_out = seams.get("left_out", 0)
    if left_out and not seams["echoes"]:
        return [
            "The seams between blocks were not measured: the survey's places are single blocks, or have more cells "
            "than run.seam_check_cells."
        ]
    share = seams["flags_differ"] / max(seams["echoes"], 1)
    off = (seams["cells_off"] + seams["cells_one_sided"]) / max(seams["cells"], 1)
    notes = [
        f"The filter works in blocks of {facts['block']:g} m. Run once more over the whole survey as one block, it "
        f"changes {number(seams['flags_differ'])} flags ({100 * share:.4f} % of the echoes) and moves the terrain by "
        f"more than {100 * seams['within']:g} cm in {100 * off:.3f} % of the cells."
    ]
    if left_out:
        notes.append(
            f"{number(left_out)} echoes took no part: they lie in places of a single block, or in places with more "
            "cells than run.seam_check_cells."
        )
    if share > FLAGS_LIMIT.get(facts["method"], RASTER_LIMIT) or off > CELLS_LIMIT:
        notes.append("That is more than it should be: choose larger blocks or a wider halo (ground.block, block_halo).")
    return notes
