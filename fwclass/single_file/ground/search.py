"""`fwclass ground --optimize`: the parameters of a filter that fit a labelled cloud best, and how good they are."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from fwclass import __version__, conf
from fwclass.errors import ConfigError
from fwclass.graph.ground_trial import FilterTrial, halves, ranges_of, search_halves, start_of
from fwclass.ground.params import GroundParams, section_of
from fwclass.ground.search import Setting, most_runs
from fwclass.ground.tuning_params import GroundSearchParams, Values
from fwclass.publish.files import check_free, written_whole
from fwclass.publish.parameter_curves import draw_curves
from fwclass.read.cloud import read_point_cloud
from fwclass.single_file.ground.file import filter_cloud, shown_points
from fwclass.single_file.ground.labels import labels_of
from fwclass.single_file.ground.params import ground_params
from fwclass.single_file.tiles import Tell, quiet
from fwclass.store.atomic import write_json
from fwclass.survey.systems import given_crs


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

    Returns plain data for JSON. ``recommended`` is "best", or "start" where the found parameters are no better on
    points that did not choose them; ``param`` and ``yaml`` are those of the recommended ones.

    `InputError` or `ConfigError`: without labels of both kinds, or for a method that has no ranges.
    """
    began = time.perf_counter()
    params = ground_params(method, preset, assignments, settings)
    limits: GroundSearchParams = conf.section("ground_search", settings)
    ranges = ranges_of(params, limits)
    if out is not None:
        check_directory(out, ("search.json", "ground.yaml", "kappa.png"), overwrite)
    cloud = read_point_cloud(source, given_crs(crs, "--crs"))
    tell("reading")
    truth, shown = labels_of(cloud, reference), shown_points(cloud)
    judged = shown & ~filter_cloud(cloud, shown, params).noise
    half = halves(cloud.x, cloud.y, cloud.usable)
    trial = FilterTrial((cloud.x, cloud.y, cloud.z), cloud.last, judged, half, truth, params, ranges)
    start = start_of(params, ranges)
    runs = 3 * most_runs(ranges, limits)
    tell(f"{params.method}: how long a run takes")
    say(announcement(params.method, runs, [_time_run(trial, s) for s in (start, *_ends(ranges))]))
    trial.tell = lambda: tell(f"{params.method}: run {len(trial.known) + 1} of at most {runs}")
    plain = _search(trial, start, limits)
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


def _search(trial: FilterTrial, start: Setting, limits: GroundSearchParams) -> dict[str, Any]:
    """What `search_halves` finds, and the words for whichever parameters are recommended."""
    searches = search_halves(trial, start, limits)
    better = (searches["held_out"]["kappa"] or -1.0) > (searches["start"]["kappa"] or -1.0)
    values = searches["best" if better else "start"]["parameters"]
    return {
        **searches,
        "recommended": "best" if better else "start",
        "param": " ".join(f"--param {name}={value:g}" for name, value in values.items()),
        "yaml": fragment(trial.params, values),
    }


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


def check_directory(out: Path, names: tuple[str, ...], overwrite: bool) -> None:
    """`ConfigError` if `out` is a file, or has one of the files already."""
    if out.exists() and not out.is_dir():
        raise ConfigError("the output is not a directory", where=out, do="choose another --out")
    there = [name for name in names if (out / name).exists()]
    if there and not overwrite:
        raise ConfigError(
            "the output exists", where=out, got=", ".join(there), do="choose another --out, or add --overwrite"
        )
    for name in names:
        check_free(out / name, overwrite)


def _write(out: Path, result: dict[str, Any]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    best = result["best"]["parameters"]
    picture = draw_curves(result["curves"], best, result["method"], result["held_out"]["kappa"])
    for name, text in (("kappa.png", picture), ("ground.yaml", result["yaml"].encode())):
        with written_whole(out / name) as beside:
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


def _time_run(trial: FilterTrial, setting: Setting) -> float:
    """Seconds of one run; the filter has run before, so that nothing is compiled."""
    began = time.perf_counter()
    trial.matrices(setting)
    return time.perf_counter() - began


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
