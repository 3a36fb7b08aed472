"""What the models are that have a name."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fwclass.errors import FwclassError, visible
from fwclass.store.installed_models import PACKAGE, VARIABLE, installed_models
from fwclass.store.models import load_model
from fwclass.study.training_text import measured_lines


def facts_of_models() -> list[dict[str, Any]]:
    """Of every model that has a name: ``name``, ``where``, ``kind``, ``classes``, ``features``, ``samples``, and
    ``measured`` (`measured_facts`) or ``fault``; plain data."""
    facts = []
    for name, place in sorted(installed_models().items()):
        one: dict[str, Any] = {"name": name, "where": str(place)}
        try:
            model = load_model(place)
        except FwclassError as fault:
            facts.append({**one, "fault": fault.what})
            continue
        classes = [{"name": c.name, "code": c.code} for c in model.classes]
        known = {"kind": model.kind, "classes": classes, "features": list(model.features)}
        facts.append({**one, **known, "samples": model.card.get("samples"), "measured": model.card.get("measured")})
    return facts


def describe(facts: Sequence[dict[str, Any]]) -> str:
    """The same for a terminal."""
    if not facts:
        named = os.environ.get(VARIABLE)
        return f"no model has a name here: install the package {PACKAGE.replace('_', '-')}, or " + (
            f"put models into {visible(named)}, which {VARIABLE} names"
            + ("" if Path(named).is_dir() else ": it does not exist")
            if named
            else f"let {VARIABLE} name a directory of models (docs/models.md)"
        )
    lines = []
    for one in facts:
        lines.append(f"{visible(one['name'])}")
        if "fault" in one:
            lines += [f"  damaged: {visible(one['fault'])}", f"  {visible(one['where'])}"]
            continue
        classes = ", ".join(f"{visible(c['name'])} {c['code']}" for c in one["classes"])
        lines.append(f"  {one['kind']} of {len(one['features'])} features: {classes}")
        measured = one["measured"] if isinstance(one["measured"], dict) else {}
        try:
            judged = measured_lines(measured)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
            judged = []
        lines += [f"  {visible(line)}" for line in judged] or ["  its card does not say how good it is elsewhere"]
        lines.append(f"  {visible(one['where'])}")
    return "\n".join(lines)
