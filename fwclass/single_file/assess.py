"""`fwclass assess`: two clouds compared, without a run directory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass import conf
from fwclass.assess.blocks import BlockCounts
from fwclass.assess.confusion import confusion, count_unclassified, figures
from fwclass.assess.objects import ObjectCells, cells_across, count_objects, object_classes, object_figures
from fwclass.errors import ConfigError, InputError, nearest
from fwclass.grid import quantise
from fwclass.model import ClassDef
from fwclass.neighbours import Points
from fwclass.read.cloud import FAR
from fwclass.read.source import open_source
from fwclass.read.stage import read_cloud
from fwclass.read.text import is_text, read_text
from fwclass.schema import Table
from fwclass.single_file import likeness
from fwclass.single_file.likeness import SAID_FROM, Likeness
from fwclass.single_file.pairing import pairs
from fwclass.store.atomic import file_digest
from fwclass.store.unchanged import check_unchanged

GROUND = (ClassDef("ground", 2, (2,)), ClassDef("other", 1, (1, *range(3, 256))))
"""Ground against everything else, as ground filters are judged (He 2023)."""


def _cloud(path: Path) -> tuple[Table, Any]:
    """Points of a LAS or text file: x, y, z to the millimetre, source_class; and their coordinate system or None."""
    if is_text(path):
        return _of_text(path), None
    source = open_source(path)
    if source.n_points == 0:
        raise InputError("the file has no points", where=path, do="there is nothing to assess")
    table = read_cloud(path, 0, source.n_points)
    return table.with_columns({n: quantise(table[n]) for n in "xyz"}), source.crs


def _of_text(path: Path) -> Table:
    text = read_text(path)
    codes = text.codes
    if codes is None:
        raise InputError(
            "the text has no classes",
            where=path,
            expected="a fourth column: class codes, or the labels 0 (ground) and 1 (object)",
            got="x y z",
            do="give a file with labels",
        )
    columns = {n: quantise(np.where(np.abs(a) < FAR, a, np.nan)) for n, a in zip("xyz", text.xyz, strict=True)}
    return Table({**columns, "source_class": codes})


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


def assess_files(
    reference: Path, prediction: Path, codes: str | None, ground: bool = False, objects: str | None = None
) -> dict[str, Any]:
    """Figures of `prediction` against `reference`: point by point, or by nearest point within `label.max_distance`.

    Both are LAS, LAZ, COPC or text with labels, or patterns of such (``tiles/*.laz``), whose files of one name are
    compared and counted together. Without `codes` every code that the reference uses is a class (0 is
    "never classified"). With `ground` there are two classes, ground (2) and all other codes; whatever the prediction
    does not call ground is other. ``objects`` is what `object_figures` tells of the classes that `objects` names, with
    commas between; of None those whose codes are things; None where there is no such class. ``left_out`` counts
    reference points of codes that no class has, by code; ``implausible`` and ``remarks`` tell what the pairs themselves
    show (`likeness`).
    """
    if ground and codes is not None:
        raise ConfigError("--ground has its own classes", where="--map", got=codes, do="leave out --map or --ground")
    pairs_of_files = _pairs_of_files(reference, prediction)
    with check_unchanged(*(path for pair in pairs_of_files for path in pair)):
        some = [_codes_of_pair(*pair) for pair in pairs_of_files]
    wanted, answered, x, y = (np.concatenate([pair[k] for pair in some]) for k in range(4))
    alike, given = [pair[4] for pair in some], answered
    classes, answered = _classes(wanted, answered, codes, ground)
    names = [c.name for c in classes]
    plain = figures(confusion(wanted, answered, classes), names, count_unclassified(wanted, answered, classes))
    left_out = _left_out(wanted, classes)
    return {
        **plain,
        "objects": _objects((x, y), wanted, answered, classes, objects),
        "matched": len(wanted),
        "unmatched": sum(one.points - one.matched for one in alike),
        "left_out": left_out,
        "implausible": likeness.faults(alike),
        "remarks": [*_twice(pairs_of_files), *likeness.remarks(alike), *_unknown(given, classes, ground)],
    }


def _objects(
    xy: tuple[NDArray[np.float64], NDArray[np.float64]],
    wanted: NDArray[np.uint8],
    answered: NDArray[np.uint8],
    classes: tuple[ClassDef, ...],
    asked: str | None,
) -> dict[str, Any] | None:
    params, names = conf.section("assess"), [c.name for c in classes]
    called = None if asked is None else [name.strip() for name in asked.split(",")]
    for name in called or ():
        if name not in names:
            raise ConfigError(
                f"no class is called {name!r}",
                where="--objects",
                expected=", ".join(names),
                got=name,
                do=nearest(name, names),
            )
    judged = object_classes(classes, called)
    if not judged:
        return None
    blocks = BlockCounts.of(*xy, wanted, answered, classes, params.block)
    cell = cells_across(blocks.counts, params.block, params.objects) * params.objects.step
    cells = ObjectCells.of(xy, wanted, answered, classes, judged, cell)
    return object_figures(count_objects(cells, len(classes), cell, params.objects), names, cell, params.objects)


def _twice(pairs_of_files: list[tuple[Path, Path]]) -> list[str]:
    """That files of a pattern hold the same bytes."""
    said = []
    for k, what in enumerate(("references", "predictions")):
        by_size: dict[int, list[Path]] = {}
        for pair in pairs_of_files:
            by_size.setdefault(pair[k].stat().st_size, []).append(pair[k])
        by_bytes: dict[str, list[str]] = {}
        for path in (p for some in by_size.values() if len(some) > 1 for p in some):
            by_bytes.setdefault(file_digest(path), []).append(path.name)
        said += [f"{what} are counted twice: {' and '.join(names)}" for names in by_bytes.values() if len(names) > 1]
    return said


def _unknown(answered: NDArray[np.uint8], classes: tuple[ClassDef, ...], ground: bool) -> list[str]:
    """That predictions have codes that no class has, and so count as wrong."""
    if ground:
        never = int((answered == 0).sum())
        share = never / len(answered)
        many = f"{never:,} predicted points ({100 * share:.1f} %) have code 0, never classified, and count as no ground"
        return [many] if share > SAID_FROM else []
    others = _left_out(answered, classes)
    others.pop("0", None)
    total = sum(others.values())
    if total <= SAID_FROM * len(answered):
        return []
    listed = ", ".join(f"{code}: {n:,}" for code, n in others.items())
    return [f"{total:,} predicted points have codes that no class has ({listed}), and count as unclassified: --map?"]


def _codes_of_pair(reference: Path, prediction: Path) -> tuple[Any, ...]:
    """Codes of the reference's points that have a predicted one, those predicted, x and y of these points [m], and how
    alike the two clouds are."""
    (truth, one), (answer, other) = _cloud(reference), _cloud(prediction)
    rows = pairs(_places(truth), _places(answer), conf.section("label").max_distance)
    known = rows >= 0
    if not known.any():
        raise InputError(
            "reference and prediction have no point in common",
            where=f"{reference}, {prediction}",
            do="check that they show the same place in the same coordinate system",
        )
    alike = Likeness.of(
        (reference.name, prediction.name),
        (one, other),
        (_places(truth), _places(answer)),
        rows,
        answer["source_class"],
        reference.samefile(prediction),
    )
    x, y = truth["x"][known], truth["y"][known]
    return truth["source_class"][known], answer["source_class"][rows[known]], x, y, alike


def _pairs_of_files(reference: Path, prediction: Path) -> list[tuple[Path, Path]]:
    """The files of two patterns, by their names without ending; one file each, whatever their names."""
    some, others = ({p.name.split(".")[0]: p for p in _files(pattern)} for pattern in (reference, prediction))
    if len(some) == len(others) == 1:
        return list(zip(some.values(), others.values(), strict=True))
    alone = sorted(some.keys() ^ others.keys())
    if alone:
        raise InputError(
            "a file has no partner of its name",
            where=f"{reference}, {prediction}",
            expected="as many predictions as references, of the same names",
            got=", ".join(alone[:3]) + (f" and {len(alone) - 3} more" if len(alone) > 3 else ""),
            do="give patterns that match the same names",
        )
    return [(some[name], others[name]) for name in sorted(some)]


def _files(pattern: Path) -> list[Path]:
    """The file of that name, or the files whose names match."""
    if pattern.exists() or not any(c in pattern.name for c in "*?["):
        return [pattern]
    files = sorted(p for p in pattern.parent.glob(pattern.name) if p.is_file())
    if not files:
        raise InputError("no file matches", where=pattern, do="check the pattern, and quote it for the shell")
    return files


def _left_out(codes: NDArray[np.uint8], classes: tuple[ClassDef, ...]) -> dict[str, int]:
    """Reference points by a code that no class counts: they are in none of the figures."""
    used = {code for one in classes for code in one.codes}
    present, counts = np.unique(codes, return_counts=True)
    return {str(c): int(n) for c, n in zip(present.tolist(), counts.tolist(), strict=True) if c not in used}


def _classes(
    wanted: NDArray[np.uint8], answered: NDArray[np.uint8], codes: str | None, ground: bool
) -> tuple[tuple[ClassDef, ...], NDArray[np.uint8]]:
    """The classes that are told apart, and the predicted codes, each as its class' own."""
    if ground:
        return GROUND, np.where(answered == 2, 2, 1).astype(np.uint8)
    if codes is None:
        return tuple(ClassDef(str(c), int(c), (int(c),)) for c in np.unique(wanted) if c), answered
    classes = parse_classes(codes)
    own = np.zeros(256, np.uint8)
    for one in classes:
        own[list(one.codes)] = one.code
    return classes, own[answered]


def _places(cloud: Table) -> Points:
    return cloud["x"], cloud["y"], cloud["z"]
