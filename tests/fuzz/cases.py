"""What a command is tried with: words, sound files, and patches of ground to make them of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import lasmaker
import numpy as np
import seeds
from mutate import Field, Files
from seeds import Seed


@dataclass(frozen=True)
class Case:
    """Words after `fwclass`, given where the files of `seed` lie; those of `fixed` lie there too and are left whole.

    `stdin`: the file that is read as standard input; none where it is empty. `sealed`: makes sums of damaged files fit,
    as who means harm would. `links`: names of links, and what each leads to.
    """

    seed: Seed
    words: tuple[str, ...]
    fixed: Files = field(default_factory=dict)
    stdin: str = ""
    sealed: Callable[[Files], Files] = dict
    links: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Command:
    """`cases` makes them in a directory; `share`: of a long run's inputs, relative to the others; `memory`: bytes that
    an input may take beside `MEMORY_EACH` for each of its own."""

    cases: Callable[[Path], list[Case]]
    share: float = 1.0
    memory: int = 64 << 20


SURVEY = """survey:
  name: small
  directory: .
  sources: [a.las]
  reference: {kind: source}
  crs: EPSG:32633
  features: [zc, height_range_c100]
  classes: [{name: a, code: 2, codes: [2]}, {name: b, code: 5, codes: [5]}]
areas: {train: [[500000, 5400000, 500005, 5400010]], gap: 0.5}
tile: {size: 20.0}
train: {trees: 5}
publish: {figure_pixels: 200}
"""


def patch(folder: Path, name: str = "a.las", point_format: int = 6, seed: int = 0) -> Seed:
    """A slope of 10 m × 10 m with bushes: 300 points of classes 2 and 5."""
    folder.mkdir(parents=True, exist_ok=True)
    r = np.random.default_rng(seed)
    x, y, bush = *r.uniform(0, 10, (2, 300)), r.random(300) < 0.3
    z = 200 + 0.1 * x + r.normal(0, 0.02, 300) + bush * r.uniform(0.5, 6, 300)
    path = folder / name.replace(".laz", ".las")
    xyz = np.c_[500000 + x, 5400000 + y, z]
    classes, times = np.where(bush, 5, 2), 1000 + np.arange(300) * 1e-3
    lasmaker.write_las(path, xyz, point_format=point_format, classification=classes, gps_time=times)
    if name.endswith(".laz"):
        lasmaker.to_laz(path, folder / name)
        path.unlink()
        return seeds._taken(folder, f"patch{point_format}z", name, seeds._laz_numbers(folder / name))
    return seeds._taken(folder, f"patch{point_format}", name, seeds._las_numbers(path))


def moved(seed: Seed, folder: str) -> Seed:
    """The seed with its files in a directory."""
    return replace(
        seed,
        main=f"{folder}/{seed.main}",
        files={f"{folder}/{n}": d for n, d in seed.files.items()},
        fields=tuple(Field(f"{folder}/{f.name}", f.at, f.size) for f in seed.fields),
        texts=tuple(f"{folder}/{n}" for n in seed.texts),
    )


def both(first: Seed, second: Seed) -> Seed:
    """Two seeds side by side, in `a` and `b`; both are damaged."""
    one, two = moved(first, "a"), moved(second, "b")
    name = f"{first.name}+{second.name}"
    return Seed(name, one.main, {**one.files, **two.files}, one.fields + two.fields, one.texts + two.texts)


def given(some: list[Seed], *words: str, fixed: Files | None = None, mark: str = "") -> list[Case]:
    """A case of each; `{}` among the words is its main file."""
    return [Case(replace(s, name=s.name + mark), tuple(w.format(s.main) for w in words), fixed or {}) for s in some]
