"""`fwclass ground --optimize`: the parameters of a filter that fit a labelled cloud best, and how good they are."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from fwclass import __version__, conf
from fwclass.assess.confusion import figures
from fwclass.errors import ConfigError
from fwclass.graph.survey import given_crs
from fwclass.ground.blocks import ground_by_blocks
from fwclass.ground.params import GroundParams, section_of
from fwclass.ground.search import Setting, curves, most_runs, search
from fwclass.ground.tuning_params import GroundSearchParams, Values
from fwclass.publish.files import whole
from fwclass.publish.parameter_curves import draw_curves
from fwclass.read.cloud import PointCloud, read_point_cloud
from fwclass.single_file.ground.file import filter_cloud, shown_points
from fwclass.single_file.ground.labels import NAMES, Matrix, halves, labels_of, matrix_of
from fwclass.single_file.ground.params import ground_params
from fwclass.single_file.ground.steps import Tell, quiet
from fwclass.single_file.pairing import Places
from fwclass.store.atomic import write_json


def optimize(
    source: Path,
    method: str | None = None,
    reference: Path | None = None,
    out: Path | None = None,
    preset: str | None = None,
    assignments: tuple[str, ...] = (),
    settings: tuple[str, ...] = (),
    crs: str | None = None,
    overwrite: bool = False,
    say: Tell = quiet,
    tell: Tell = quiet,
) -> dict[str, Any]:
    """Search the parameters of a filter with the greatest kappa on labelled points.

    The cloud is cut into 2 × 2 equal rectangles. Parameters are chosen on one pair of opposite rectangles and
    assessed on the other pair, then the other way round; both answers together are the figure that is told
    (``held_out``). The parameters that are recommended are chosen on all points.

    Parameters
    ----------
    source : LAS (class 2 is ground, 0, 7, 18, 65 and 66 are not scored, the rest is not ground) or text with labels.
    reference : file with the classes of the same points; None takes those of `source`.
    out : directory for ``search.json, ground.yaml, kappa.png``; None writes nothing.
    say : told before the search how long it may take.
    tell : told before every run of the filter.

    Returns
    -------
    dict
        Plain data for JSON. ``recommended`` is "best", or "start" where the found parameters are no better on points
        that did not choose them; ``param`` and ``yaml`` are those of the recommended ones.

    Raises
    ------
    InputError, ConfigError
        Without labels of both kinds, or for a method that has no ranges.
    """
    began = time.perf_counter()
    params = ground_params(method, preset, assignments, settings)
    limits: GroundSearchParams = conf.section("ground_search", settings)
    ranges = ranges_of(params, limits)
    if out is not None:
        check_directory(out, ("search.json", "ground.yaml", "kappa.png"), overwrite)
    cloud = read_point_cloud(source, given_crs(crs, "--crs"))
    tell("reading")
    trial = Trial(cloud, labels_of(cloud, reference), params, ranges)
    start = start_of(params, ranges)
    runs = 3 * most_runs(ranges, limits)
    tell(f"{params.method}: how long a run takes")
    say(announcement(params.method, runs, [_time_run(trial, s) for s in (start, *_ends(ranges))]))
    trial.tell = lambda: tell(f"{params.method}: run {len(trial.known) + 1} of at most {runs}")
    plain = _search(trial, start, ranges, limits)
    plain = {
        "input": str(source),
        "reference": str(reference or source),
        "fwclass": __version__,
        "method": params.method,
        **plain,
        "runs": len(trial.known),
        "seconds": round(time.perf_counter() - began, 3),
    }
    if out is not None:
        _write(out, plain)
    return plain


class Trial:
    """Confusion matrices of a filter's settings on a labelled cloud, each computed once."""

    def __init__(
        self, cloud: PointCloud, truth: NDArray[np.int8], params: GroundParams, ranges: dict[str, Values]
    ) -> None:
        """`truth` is 1 for ground, 0 for other points, -1 where it is not known."""
        shown = shown_points(cloud)
        noise = filter_cloud(cloud, shown, params).noise
        rows = np.flatnonzero(shown & ~noise)
        self.points: Places = cloud.x[rows], cloud.y[rows], cloud.z[rows]
        self.last = cloud.last[rows]
        self.rows, self.truth, self.shown = rows, truth, shown
        self.half = halves(cloud)
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


def _search(trial: Trial, start: Setting, ranges: dict[str, Values], limits: GroundSearchParams) -> dict[str, Any]:
    """The searches on all points and on either half, and what they found."""
    best = search(ranges, start, trial.kappa, limits)
    chosen = [search(ranges, start, partial(trial.kappa, half=half), limits).setting for half in (0, 1)]
    held_out = trial.matrices(chosen[0])[1] + trial.matrices(chosen[1])[0]
    before, after = (sum(trial.matrices(s)) for s in (start, best.setting))
    better = figure(held_out, "kappa") > figure(before, "kappa")
    values = by_name(ranges, best.setting if better else start)
    return {
        "start": {"parameters": by_name(ranges, start), **_figures(before)},
        "best": {"parameters": by_name(ranges, best.setting), **_figures(after)},
        "held_out": {"parameters": [by_name(ranges, s) for s in chosen], **_figures(held_out)},
        "curves": {n: [list(p) for p in line] for n, line in curves(ranges, best.setting, trial.kappa).items()},
        "recommended": "best" if better else "start",
        "param": " ".join(f"--param {name}={value:g}" for name, value in values.items()),
        "yaml": fragment(trial.params, values),
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


def fragment(params: GroundParams, values: dict[str, float]) -> str:
    """YAML for a configuration: the method and the parameters that were searched."""
    own: dict[str, Any] = {}
    for name, value in values.items():
        *path, last = name.split(".")
        inner = own
        for key in path:
            inner = inner.setdefault(key, {})
        inner[last] = int(value) if float(value).is_integer() and last in ("rigidness", "iterations") else float(value)
    tree = {"ground": {"method": params.method, section_of(params.method): own}}
    return str(yaml.safe_dump(tree, sort_keys=False))


def figure(matrix: Any, name: str) -> float:
    """One figure of a confusion matrix; -1 where there is none."""
    accuracy = figures(matrix, NAMES)[name]
    return -1.0 if accuracy is None else float(accuracy)


def _figures(matrix: Any) -> dict[str, Any]:
    accuracy = figures(matrix, NAMES)
    return {name: accuracy[name] for name in ("confusion", "type_i", "type_ii", "total_error", "kappa")}


def check_directory(out: Path, names: tuple[str, ...], overwrite: bool) -> None:
    """`ConfigError` if `out` is a file, or has one of the files already."""
    if out.exists() and not out.is_dir():
        raise ConfigError("the output is not a directory", where=out, do="choose another --out")
    there = [name for name in names if (out / name).exists()]
    if there and not overwrite:
        raise ConfigError(
            "the output exists", where=out, got=", ".join(there), do="choose another --out, or add --overwrite"
        )


def _write(out: Path, result: dict[str, Any]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    best = result["best"]["parameters"]
    picture = draw_curves(result["curves"], best, result["method"], result["held_out"]["kappa"])
    for name, text in (("kappa.png", picture), ("ground.yaml", result["yaml"].encode())):
        with whole(out / name) as beside:
            beside.write_bytes(text)
    write_json(out / "search.json", result)


def describe(result: dict[str, Any]) -> str:
    """The result as text for a terminal."""
    lines = [f"{'':22}{'kappa':>8}{'type I':>9}{'type II':>9}{'total':>9}"]
    for key, label in (("start", "parameters before"), ("best", "best, on all points"), ("held_out", "held out")):
        rates = [result[key][name] for name in ("kappa", "type_i", "type_ii", "total_error")]
        shown = "".join("        -" if v is None else f"{100 * v:8.2f}%" for v in rates[1:])
        lines.append(f"{label:<22}{rates[0] if rates[0] is not None else math.nan:8.4f}{shown}")
    lines.append("held out: chosen on two opposite quarters of the area, assessed on the other two, both ways")
    if result["recommended"] == "start":
        return "\n".join([*lines, "", NO_BETTER])
    return "\n".join([*lines, "", result["param"], "", result["yaml"].rstrip()])


NO_BETTER = "the found parameters are no better on points that did not choose them: keep the present ones"


def announcement(method: str, runs: int, timed: Sequence[float]) -> str:
    """What a search of at most `runs` runs may take, by the seconds of some runs of very different settings.

    Searches seldom need less than a third or more than two thirds of the runs, and the mean stands for all of them.
    """
    low, high, mean = min(timed), max(timed), sum(timed) / len(timed)
    each = f"{low:.2f} to {high:.2f} s" if f"{low:.2f}" != f"{high:.2f}" else f"{high:.2f} s"
    about = f"{_duration(0.3 * runs * mean)} to {_duration(0.7 * runs * mean)}"
    return f"{method}: at most {runs} runs of {each}; probably {about}, at most about {_duration(runs * high)}"


def _ends(ranges: dict[str, Values]) -> tuple[Setting, Setting]:
    """The first and the last value of every range."""
    return tuple(v[0] for v in ranges.values()), tuple(v[-1] for v in ranges.values())


def _time_run(trial: Trial, setting: Setting) -> float:
    """Seconds of one run; the filter has run before, so that nothing is compiled."""
    began = time.perf_counter()
    trial.matrices(setting)
    return time.perf_counter() - began


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
