"""`fwclass assess`: two clouds compared, without a run directory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass import conf
from fwclass.assess.stage import confusion, figures, unclassified
from fwclass.errors import ConfigError, InputError
from fwclass.grid import quantised
from fwclass.model import ClassDef
from fwclass.neighbours import nearest_within
from fwclass.read.source import open_source
from fwclass.read.stage import read_cloud
from fwclass.schema import Table

SAME_POINT = 0.002
"""Two clouds are in the same order if no pair of points is further apart than this [m]."""


def _cloud(path: Path) -> Table:
    source = open_source(path)
    if source.n_points == 0:
        raise InputError("the file has no points", where=path, do="there is nothing to assess")
    table = read_cloud(path, 0, source.n_points)
    return table.with_columns({n: quantised(table[n]) for n in "xyz"})


def parse_classes(text: str) -> tuple[ClassDef, ...]:
    """``ground=2;vegetation=3,4,5`` as classes; the first code of each is its own."""
    classes = []
    for item in text.split(";"):
        name, equals, codes = item.partition("=")
        try:
            numbers = tuple(int(c) for c in codes.split(","))
        except ValueError:
            numbers = ()
        if not equals or not name.strip() or not numbers or not all(0 < n < 256 for n in numbers):
            raise ConfigError(
                "--map lists classes by name and codes",
                where="--map",
                expected="ground=2;vegetation=3,4,5;building=6",
                got=text,
            )
        classes.append(ClassDef(name.strip(), numbers[0], numbers))
    names = [c.name for c in classes]
    if len(set(names)) < len(names):
        raise ConfigError("a class is listed twice", where="--map", got=text, do="list its codes together: ground=2,8")
    return tuple(classes)


def assess_files(reference: Path, prediction: Path, codes: str | None) -> dict[str, Any]:
    """Figures of `prediction` against `reference`: point by point, or by nearest point within `label.max_distance`.

    Without `codes` every code that the reference uses is a class (0 is "never classified").
    """
    truth, answer = _cloud(reference), _cloud(prediction)
    pairs = _pairs(truth, answer, conf.section("label").max_distance)
    known = pairs >= 0
    if not known.any():
        raise InputError(
            "reference and prediction have no point in common", where=f"{reference}, {prediction}",
            do="check that they show the same place in the same coordinate system",
        )  # fmt: skip
    wanted, given = truth["source_class"][known], answer["source_class"][pairs[known]]
    if codes is not None:
        classes = parse_classes(codes)
        own = np.zeros(256, np.uint8)
        for one in classes:
            own[list(one.codes)] = one.code
        given = own[given]
    else:
        classes = tuple(ClassDef(str(c), int(c), (int(c),)) for c in np.unique(wanted) if c)
    names = [c.name for c in classes]
    made = figures(confusion(wanted, given, classes), names, unclassified(wanted, given, classes))
    return {**made, "matched": int(known.sum()), "unmatched": int((~known).sum())}


def _pairs(truth: Table, answer: Table, limit: float) -> NDArray[np.int64]:
    """Row of `answer` for every row of `truth`, -1 if none."""
    if truth.rows == answer.rows and all(np.abs(truth[n] - answer[n]).max() <= SAME_POINT for n in "xyz"):
        return np.arange(truth.rows)
    found, _ = nearest_within((truth["x"], truth["y"], truth["z"]), (answer["x"], answer["y"], answer["z"]), limit)
    return found
