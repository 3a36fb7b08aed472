"""What a ground filter has right on labelled points by its parameters, and the search for the best ones."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.assess.confusion import figures
from fwclass.classes import GROUND
from fwclass.errors import ConfigError
from fwclass.ground.blocks import ground_by_blocks
from fwclass.ground.params import GroundParams, section_of
from fwclass.ground.search import Setting, curves, search
from fwclass.ground.tuning_params import GroundSearchParams, Values
from fwclass.neighbours import Points

NAMES = ("ground", "other")
"""Classes of the confusion matrices."""

UNSCORED = (0, 7, 18, 65, 66)
"""Class codes that are no reference: never classified, noise, artefacts, synthetic points."""

Matrix = NDArray[np.int64]


def truth_of(classes: NDArray[np.uint8] | None, known: NDArray[np.bool_]) -> NDArray[np.int8]:
    """int8 (n,): 1 for points that are ground by their class, 0 for others, -1 where it is not known; bool (n,)
    `known`, a point may have a reference."""
    truth = np.full(len(known), -1, np.int8)
    if classes is not None:
        known = known & ~np.isin(classes, UNSCORED)
        truth[known] = classes[known] == GROUND
    return truth


def halves(x: NDArray[np.float64], y: NDArray[np.float64], usable: NDArray[np.bool_]) -> NDArray[np.int8]:
    """int8 (n,): 0 for points of the south-western and north-eastern quarter of the box of the `usable`, else 1."""
    sides = []
    for values in (x, y):
        used = values[usable]
        sides.append(values >= 0.5 * (float(used.min()) + float(used.max())))
    return (sides[0] ^ sides[1]).astype(np.int8)


def matrix_of(truth: NDArray[np.int8], ground: NDArray[np.bool_], rows: NDArray[np.bool_] | None = None) -> Matrix:
    """Confusion matrix, rows reference, columns filter, ground first, of the rows with a reference."""
    known = truth >= 0 if rows is None else rows & (truth >= 0)
    index = 2 * (1 - truth[known]) + ~ground[known]
    return np.bincount(index, minlength=4).reshape(2, 2)


class FilterTrial:
    """Confusion matrices of a filter's settings on a labelled cloud, each computed once."""

    def __init__(
        self,
        places: Points,
        last: NDArray[np.bool_],
        seen: NDArray[np.bool_],
        half: NDArray[np.int8],
        truth: NDArray[np.int8],
        params: GroundParams,
        ranges: dict[str, Values],
    ) -> None:
        """Of n points: `places` [m], whether they are the `last` of their pulse, whether the filter sees them (noise,
        which the search does not look for again, it does not), which `half` they lie in, and the `truth`."""
        rows = np.flatnonzero(seen)
        x, y, z = places
        self.points: Points = x[rows], y[rows], z[rows]
        self.last = last[rows]
        self.rows, self.truth, self.half = rows, truth, half
        quiet = params.noise.model_copy(update={"low": False, "high": False, "sigma_rule": False})
        self.params, self.quiet = params, params.model_copy(update={"noise": quiet})
        self.ranges = ranges
        self.known: dict[Setting, tuple[Matrix, Matrix]] = {}
        self.tell: Callable[[], None] = lambda: None

    def matrices(self, setting: Setting) -> tuple[Matrix, Matrix]:
        """Confusion matrices (rows reference, columns filter; ground first) of the two halves."""
        if setting not in self.known:
            self.tell()
            params = with_values(self.quiet, dict(zip(self.ranges, setting, strict=True)))
            ground = np.zeros(len(self.truth), bool)
            ground[self.rows] = ground_by_blocks(*self.points, self.last, params).ground
            self.known[setting] = (
                matrix_of(self.truth, ground, self.half == 0),
                matrix_of(self.truth, ground, self.half == 1),
            )
        return self.known[setting]

    def kappa(self, setting: Setting, half: int | None = None) -> float:
        """Of one half, or of all points; -1 where there is none."""
        pair = self.matrices(setting)
        value = figures(pair[0] + pair[1] if half is None else pair[half], NAMES)["kappa"]
        return -1.0 if value is None else float(value)


def search_halves(trial: FilterTrial, start: Setting, limits: GroundSearchParams) -> dict[str, Any]:
    """The searches on all points and on either half, and what they found: ``start``, ``best``, ``held_out`` (each half
    by what the other chose) with parameters and figures, ``curves`` of kappa around the best; plain data."""
    ranges = trial.ranges
    best = search(ranges, start, trial.kappa, limits)
    chosen = [search(ranges, start, partial(trial.kappa, half=half), limits).setting for half in (0, 1)]
    held_out = trial.matrices(chosen[0])[1] + trial.matrices(chosen[1])[0]
    before, after = (sum(trial.matrices(s)) for s in (start, best.setting))
    return {
        "start": {"parameters": by_name(ranges, start), **errors_of(before)},
        "best": {"parameters": by_name(ranges, best.setting), **errors_of(after)},
        "held_out": {"parameters": [by_name(ranges, s) for s in chosen], **errors_of(held_out)},
        "curves": {n: [list(p) for p in line] for n, line in curves(ranges, best.setting, trial.kappa).items()},
    }


def ranges_of(params: GroundParams, limits: GroundSearchParams) -> dict[str, Values]:
    """The ranges of the method of `params`, or `ConfigError`."""
    own = limits.ranges.get(params.method)
    if not own:
        raise ConfigError(
            "no ranges to search are declared for this filter",
            where=f"ground_search.ranges.{params.method}",
            expected=", ".join(limits.ranges),
            got=params.method,
            do="choose another --method",
        )
    return own


def start_of(params: GroundParams, ranges: dict[str, Values]) -> Setting:
    """The values that the parameters of `ranges` have now, lengths that follow from others filled in."""
    start = []
    for name in ranges:
        own: Any = params.of(params.method)
        for key in name.split("."):
            own = getattr(own, key)
        start.append(float(own))
    return tuple(start)


def with_values(params: GroundParams, values: dict[str, float]) -> GroundParams:
    """`params` with other values for parameters of its method; a name may have a section before a dot."""
    whole_section = params.of(params.method).model_dump()
    for name, value in values.items():
        *path, last = name.split(".")
        own = whole_section
        for key in path:
            own = own[key]
        own[last] = value
    section = section_of(params.method)
    return params.model_copy(update={section: type(getattr(params, section)).model_validate(whole_section)})


def by_name(ranges: dict[str, Values], setting: Setting) -> dict[str, float]:
    """A setting by the names of its parameters."""
    return dict(zip(ranges, setting, strict=True))


def errors_of(matrix: Any) -> dict[str, Any]:
    """Confusion, Type I, Type II, total error and kappa of a matrix."""
    accuracy = figures(matrix, NAMES)
    return {name: accuracy[name] for name in ("confusion", "type_i", "type_ii", "total_error", "kappa")}
