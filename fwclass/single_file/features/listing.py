"""What `fwclass features` says: of a file, and with `--list` every feature with formula, unit and source."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fwclass.columns import COLUMNS, FEATURES, SCALES, Column
from fwclass.conf.sets import feature_set, shipped_sets
from fwclass.errors import first_few, visible
from fwclass.schema import column
from fwclass.single_file.features.names import ENDS, measured_names, requested_features


def everything() -> dict[str, Any]:
    """All features, columns of echoes that count as features, kinds of neighbourhood, and sets; plain data."""
    return {
        "features": [_facts(c.name, c) for c in FEATURES],
        "measured": [_facts(name, COLUMNS[name]) for name in measured_names()],
        "scales": [{"letter": k, "meaning": about, "example": ENDS[k]} for k, about in SCALES.items()],
        "sets": [_set_facts(name) for name in shipped_sets()],
    }


def of_set(name: str, where: str = "--list") -> dict[str, Any]:
    """The features of one set, each with formula, unit and source; plain data. `where` names the option in errors."""
    return {**_set_facts(name, where), "features": [_facts(n, column(n)) for n in requested_features(name, None).names]}


def _facts(name: str, record: Column) -> dict[str, Any]:
    return {
        "name": name,
        "unit": record.unit,
        "formula": record.meaning,
        "scales": record.scales,
        "source": record.source,
    }


def _set_facts(name: str, where: str = "--list") -> dict[str, Any]:
    features = feature_set(name, where=where)
    return {
        "name": features.name,
        "size": len(features.features),
        "about": features.about,
        "source": features.source,
        "features": list(features.features),
    }


def describe_everything(facts: dict[str, Any]) -> str:
    """`everything` as text."""
    scales = [f"  _{s['example']:<5} {s['meaning']}{_SIZES[s['letter']]}" for s in facts["scales"]]
    plain = [f for f in facts["features"] if not f["scales"]]
    scaled = [f for f in facts["features"] if f["scales"]]
    sets = [f"  {s['name']:<14} {s['size']:>4}  {s['about']}" for s in facts["sets"]]
    return "\n".join(
        [
            "Features of a neighbourhood; a name ends in its scale, as in planarity_r100. N echoes, itself included.",
            *_rows(scaled),
            "",
            "Scales",
            *scales,
            "",
            "Features without a scale",
            *_rows(plain),
            "",
            "Columns of echoes that count as features too",
            *_rows(facts["measured"]),
            "",
            "Sets: --set NAME; `--list NAME` shows one",
            *sets,
        ]
    )


_SIZES = {
    "r": " 1.00 m",
    "c": " 1.00 m",
    "k": " 20 of them",
    "g": " 1.00 m, on the global grid",
    "o": " of features.optimal_radii",
}


def describe_set(facts: dict[str, Any]) -> str:
    """`of_set` as text."""
    head = f"{facts['name']}: {facts['size']} features. {facts['about']}"
    return "\n".join(
        [head, *([f"source: {facts['source']}"] if facts["source"] else []), *_rows(facts["features"], False)]
    )


def _rows(features: list[dict[str, Any]], scales: bool = True) -> list[str]:
    """Aligned columns: name, scales, unit, formula, source."""
    name = max((len(f["name"]) for f in features), default=0)
    unit = max((len(f["unit"]) for f in features), default=0)
    kind = max((len(f["scales"]) for f in features), default=0) if scales else 0
    rows = []
    for f in features:
        middle = f"{f['scales']:<{kind}}  " if kind else ""
        source = f"  [{f['source']}]" if f["source"] else ""
        rows.append(f"  {f['name']:<{name}}  {middle}{f['unit']:<{unit}}  {f['formula']}{source}")
    return rows


MANY = 8
"""So many names are shown."""


def describe(summary: Mapping[str, Any]) -> str:
    """The summary of `fwclass features`."""
    seconds = summary["seconds"]
    compiling = f", {seconds['compiling']:.1f} of them compiling, once" if seconds["compiling"] >= 1.0 else ""
    lost = summary["left_out"]
    empty = {n: c for n, c in summary["without_value"].items() if c == summary["echoes"]}
    echoes, features = _count(summary["echoes"], "echo", "echoes"), _count(len(summary["features"]), "feature")
    rows = [
        f"{visible(summary['input'])}: {echoes}, {features} of {summary['set']}",
        *summary["notes"],
        f"neighbourhoods reach {summary['reach']:g} m; {_count(summary['tiles'], 'tile')}",
        *(
            f"LEFT OUT, {why}: {first_few([n for n in lost if lost[n] == why], MANY)}"
            for why in dict.fromkeys(lost.values())
        ),
        *([f"WARNING: no echo has a value of {first_few(list(empty), MANY)}"] if empty else []),
        f"{seconds['all']:.1f} s{compiling}",
        f"written: {visible(summary['output'])} ({summary['bytes'] / 1e6:.1f} MB)",
    ]
    return "\n".join(rows)


def _count(n: int, one: str, many: str = "") -> str:
    return f"{n:,} {one if n == 1 else many or f'{one}s'}"
