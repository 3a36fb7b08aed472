"""`fwclass ground --compare`: several ground filters on one cloud, side by side on one page."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass import __version__, conf
from fwclass.assess.confusion import figures
from fwclass.errors import ConfigError, InputError
from fwclass.graph.ground_trial import NAMES, matrix_of
from fwclass.ground.filters import FILTERS, Flags
from fwclass.ground.measure import measure
from fwclass.ground.params import GroundParams
from fwclass.ground.raster.lattice import cells_of, window_over
from fwclass.publish.figures import relief, tint_range
from fwclass.publish.ground_page import disagreement_map, render_comparison
from fwclass.read.cloud import PointCloud, read_point_cloud
from fwclass.single_file.ground.file import filter_cloud, shown_points
from fwclass.single_file.ground.labels import labels_of
from fwclass.single_file.ground.params import closest, ground_params, used_params
from fwclass.single_file.ground.rasters import check_extent, terrain_of
from fwclass.single_file.ground.search import check_directory
from fwclass.single_file.tiles import Tell, quiet
from fwclass.store.atomic import write_json
from fwclass.survey.systems import given_crs

FILES = ("comparison.html", "comparison.json")
MAJORITY = "majority"
"""Row of what more than half of the filters call ground."""


def compare(
    source: Path,
    methods: str | None = None,
    out: Path | None = None,
    preset: str | None = None,
    settings: tuple[str, ...] = (),
    crs: str | None = None,
    reference: Path | None = None,
    overwrite: bool = False,
    adapt: Callable[..., tuple[GroundParams, dict[str, Any]]] | None = None,
    say: Tell = quiet,
    tell: Tell = quiet,
) -> dict[str, Any]:
    """Run filters on a cloud and write ``comparison.html`` and ``comparison.json`` into `out`.

    Parameters
    ----------
    methods : names with commas between them; None or ``all`` takes every single filter.
    out : directory; None is ``<input>-ground`` in the current one.
    adapt : changes the parameters of a method to the data, as in `ground_file`.
    say, tell : told what was found, and what begins.

    Returns plain data for JSON: per filter parameters, seconds, shares and, with labels, figures; agreement by
    pairs.

    `ConfigError` or `InputError`: an unknown filter, an output that exists, an input that cannot be used.
    """
    names = methods_of(methods)
    target = out if out is not None else Path(f"{source.stem}-ground")
    check_directory(target, FILES, overwrite)
    cloud = read_point_cloud(source, given_crs(crs, "--crs"))
    shown = shown_points(cloud)
    check_extent(cloud, shown, conf.section("terrain", settings).cell)
    truth = _labels(cloud, reference)
    flags, filters = {}, []
    for name in names:
        params = ground_params(name, preset, (), settings)
        if adapt is not None:
            params, _ = adapt(cloud, shown, params)
        flags[name], plain = _one(cloud, shown, truth, name, params, tell)
        say(f"{name}: {plain['seconds']:.2f} s, {100 * plain['ground_share']:.1f} % ground")
        filters.append(plain)
    votes = np.sum([f.ground for f in flags.values()], axis=0)
    majority = Flags(votes * 2 > len(names), np.logical_and.reduce([f.noise for f in flags.values()]))
    filters.append(_summary(shown, truth, MAJORITY, majority))
    tell("measuring")
    plain = {
        "input": str(source),
        "fwclass": __version__,
        "points": cloud.points,
        "shown": int(shown.sum()),
        "measured": measure(*_of(cloud, shown)).plain(),
        "labelled": truth is not None,
        "filters": filters,
        "agreement": agreement(list(flags.values()), shown),
        "methods": list(names),
        "votes": np.bincount(votes[shown], minlength=len(names) + 1).tolist(),
    }
    pictures = _pictures(cloud, shown, {**flags, MAJORITY: majority}, votes, plain, settings, tell)
    target.mkdir(parents=True, exist_ok=True)
    page = render_comparison(plain, pictures, target / "comparison.html")
    write_json(target / "comparison.json", plain)
    return {**plain, "page": page["path"]}


def methods_of(text: str | None) -> tuple[str, ...]:
    """Names of single filters, each once, or a `ConfigError`."""
    if text is None or text.strip() in ("", "all"):
        return tuple(FILTERS)
    names = tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    unknown = [n for n in names if n not in FILTERS]
    if unknown:
        raise ConfigError(
            "there is no such filter",
            where="--compare",
            expected=", ".join(FILTERS),
            got=unknown[0],
            do=closest(unknown[0], FILTERS),
        )
    if len(names) < 2:
        raise ConfigError("at least two filters can be compared", where="--compare", got=text, do="name another")
    return names


def _labels(cloud: PointCloud, reference: Path | None) -> NDArray[np.int8] | None:
    if reference is not None:
        return labels_of(cloud, reference)
    try:
        return labels_of(cloud)
    except InputError:
        return None


def _of(cloud: PointCloud, rows: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    return tuple(a[rows] for a in (cloud.x, cloud.y, cloud.z, cloud.last))


def _one(
    cloud: PointCloud,
    shown: NDArray[np.bool_],
    truth: NDArray[np.int8] | None,
    name: str,
    params: GroundParams,
    tell: Tell,
) -> tuple[Flags, dict[str, Any]]:
    """Flags of one filter, and what is told of it; a first run on some points keeps compiling out of the time."""
    tell(f"filter {name}")
    some = np.flatnonzero(shown)[:200]
    filter_cloud(cloud, np.isin(np.arange(cloud.points), some), params.model_copy(update={"last_returns": False}))
    began = time.perf_counter()
    flags = filter_cloud(cloud, shown, params, tell)
    seconds = time.perf_counter() - began
    summary = _summary(shown, truth, name, flags)
    rate = {"seconds": round(seconds, 3), "points_per_second": round(int(shown.sum()) / max(seconds, 1e-9))}
    return flags, {**summary, **rate, "parameters": used_params(params)}


def _summary(shown: NDArray[np.bool_], truth: NDArray[np.int8] | None, name: str, flags: Flags) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "method": name,
        "ground": int(flags.ground.sum()),
        "noise": int(flags.noise.sum()),
        "ground_share": float(flags.ground.sum() / max(int(shown.sum()), 1)),
        "seconds": None,
        "points_per_second": None,
        "parameters": None,
        "accuracy": None,
    }
    if truth is not None:
        accuracy = figures(matrix_of(truth, flags.ground), NAMES)
        plain["accuracy"] = {k: accuracy[k] for k in ("confusion", "type_i", "type_ii", "total_error", "kappa")}
    return plain


def agreement(filters: Sequence[Flags], shown: NDArray[np.bool_]) -> list[list[float]]:
    """Share of the shown points that two filters call the same, for all pairs."""
    flags = [f.ground[shown] for f in filters]
    return [[float((a == b).mean()) for b in flags] for a in flags]


def _pictures(
    cloud: PointCloud,
    shown: NDArray[np.bool_],
    flags: dict[str, Flags],
    votes: NDArray[Any],
    plain: dict[str, Any],
    settings: tuple[str, ...],
    tell: Tell,
) -> dict[str, bytes]:
    """Shaded relief of every filter's terrain, and the map of disagreement under its own name."""
    publish = conf.section("publish", settings)
    x, y = cloud.x[shown], cloud.y[shown]
    terrains = {}
    for name, f in flags.items():
        tell(f"terrain of {name}")
        terrains[name] = terrain_of(cloud, f, shown, settings)
    tell("pictures")
    known = {n: (t["dtm"], window) for n, (t, window) in terrains.items() if np.isfinite(t["dtm"]).any()}
    tints = tint_range(np.concatenate([dtm.reshape(-1) for dtm, _ in known.values()])) if known else None
    pictures = {name: relief(dtm, window, publish, tints) for name, (dtm, window) in known.items()}
    cell = max(0.5, round(2.0 * plain["measured"]["spacing"], 1))
    window = window_over(x, y, cell, "the map's cell")
    most, own = len(flags) - 1, votes[shown]
    cells, _ = cells_of(x, y, window)
    split = np.minimum(own, most - own)
    pictures["disagreement"] = disagreement_map(
        by_cell(cells, split, window.shape),
        by_cell(cells, np.where(2 * own > most, 2, 1), window.shape),
        most,
        window,
        publish,
    )
    return pictures


def by_cell(cells: NDArray[np.int64], values: NDArray[Any], shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Largest value of the points of every cell, 0 where there is none."""
    out = np.zeros(shape, np.uint8)
    np.maximum.at(out.reshape(-1), cells, values.astype(np.uint8))
    return out


def describe(result: dict[str, Any]) -> str:
    """The result as text for a terminal."""
    wide = max(len(f["method"]) for f in result["filters"])
    head = f"{'':{wide}}{'seconds':>9}{'pts/s':>9}{'ground':>9}"
    lines = [head + (f"{'type I':>9}{'type II':>9}{'total':>9}{'kappa':>8}" if result["labelled"] else "")]
    for one in result["filters"]:
        time_ = f"{one['seconds']:9.2f}{speed(one['points_per_second']):>9}" if one["seconds"] is not None else " " * 18
        line = f"{one['method']:<{wide}}{time_}{100 * one['ground_share']:8.1f}%"
        if one["accuracy"]:
            shares = [one["accuracy"][k] for k in ("type_i", "type_ii", "total_error")]
            line += "".join(f"{100 * v:8.2f}%" if v is not None else f"{'-':>9}" for v in shares)
            kappa = one["accuracy"]["kappa"]
            line += f"{kappa:8.3f}" if kappa is not None else f"{'-':>8}"
        lines.append(line)
    n = len(result["methods"])
    same = (result["votes"][0] + result["votes"][n]) / max(sum(result["votes"]), 1)
    return "\n".join([*lines, "", f"all {n} filters agree on {100 * same:.1f} % of the points", _MAJORITY])


_MAJORITY = (
    "majority: more than half of these filters say ground; --method consensus asks ground.consensus.methods instead,\n"
    "and shows each of them the widest surroundings that one needs, so that some flags differ"
)


def speed(points: float) -> str:
    """Points a second, with three figures."""
    return f"{points / 1e6:.2f} M" if points >= 1e6 else f"{points / 1e3:.3g} k"
