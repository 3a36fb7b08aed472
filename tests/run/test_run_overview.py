"""Overviews: the echoes with the lowest hashes of the survey, and of squares that no tile decides."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from runmaker import walk

from fwclass.publish.octree import echo_hashes
from fwclass.schema import IDENTITY, Table

SQUARE, MOST = 50.0, 3000
SMALL = (f"publish.overview_square={SQUARE}", f"publish.overview_echoes={MOST}")


@pytest.fixture(scope="module")
def several(survey: Path, begun: Callable[[str], Path]) -> Path:
    root = begun("several")
    runner, _ = walk(survey, root, *SMALL)
    assert not runner.failures
    return root


def echoes_of(root: Path) -> dict[str, np.ndarray]:
    tables = [pq.read_table(p, columns=[*IDENTITY, "x", "y"]) for p in sorted((root / "parquet").glob("*.parquet"))]
    return {n: np.concatenate([t[n].to_numpy() for t in tables]) for n in (*IDENTITY, "x", "y")}


def who(strip: np.ndarray, pulse: np.ndarray, number: np.ndarray) -> set[tuple[int, int, int]]:
    return set(zip(strip.tolist(), pulse.tolist(), number.tolist(), strict=True))


def identities(path: Path) -> set[tuple[int, int, int]]:
    las = laspy.read(path)
    out = who(*(np.asarray(las[n]) for n in ("point_source_id", "pulse", "return_number")))
    assert len(out) == len(las.points)
    return out


def test_each_overview_has_the_lowest_hashes_of_its_place(several: Path) -> None:
    echoes = echoes_of(several)
    rank = np.argsort(echo_hashes(Table({n: echoes[n] for n in IDENTITY})))
    square = [tuple(s) for s in np.floor(np.c_[echoes["x"], echoes["y"]] / SQUARE).astype(int)[rank].tolist()]
    order = who(*(echoes[n][rank[:MOST]] for n in IDENTITY))
    assert identities(several / "laz" / "overview.copc.laz") == order and len(order) == MOST
    files = {p.name.removesuffix(".copc.laz"): p for p in (several / "laz" / "overviews").iterdir()}
    assert set(files) == {f"{i}_{j}" for i, j in square} and len(files) > 3
    for key, path in files.items():
        mine = rank[[k for k, s in enumerate(square) if f"{s[0]}_{s[1]}" == key][:MOST]]
        assert identities(path) == who(*(echoes[n][mine] for n in IDENTITY))


def test_the_list_names_the_overviews_that_show_a_tile(several: Path) -> None:
    items = json.loads((several / "laz" / "survey.vpc").read_text())["features"]
    for k, item in enumerate(items):
        assets = [item["assets"][n] for n in item["assets"] if n != "data"]
        assert all(a["roles"] == ["overview"] and (several / "laz" / a["href"]).is_file() for a in assets)
        x0, y0, _, x1, y1, _ = item["properties"]["proj:bbox"]
        spans = [range(math.floor(a / SQUARE), math.floor(b / SQUARE) + 1) for a, b in ((x0, x1), (y0, y1))]
        near = [f"./overviews/{i}_{j}.copc.laz" for i in spans[0] for j in spans[1]]
        whole = ["./overview.copc.laz"] if k in (0, len(items) - 1) else []
        assert [a["href"] for a in assets] == whole + near and "overview" in item["assets"]


def overviews(root: Path) -> dict[str, bytes]:
    laz = (root / "laz").resolve()
    paths = (laz / "overview.copc.laz", *(laz / "overviews").iterdir())
    return {p.relative_to(laz).as_posix(): p.read_bytes() for p in paths}


@pytest.mark.slow
def test_tiles_change_no_byte_of_an_overview(several: Path, survey: Path, tmp_path: Path) -> None:
    for size in ("32.5", "1000"):
        walk(survey, tmp_path / size, *SMALL, f"tile.size={size}")
        assert overviews(tmp_path / size) == overviews(several)


def test_a_survey_that_one_overview_holds_has_one(finished: tuple[Path, object]) -> None:
    root = finished[0]
    assert not (root / "laz" / "overviews").exists()
    echoes = echoes_of(root)
    assert identities(root / "laz" / "overview.copc.laz") == who(*(echoes[n] for n in IDENTITY))


def test_where_no_square_is_drawn_the_tiles_are(finished: tuple[Path, object], survey: Path, tmp_path: Path) -> None:
    root = tmp_path / "run"
    shutil.copytree(finished[0], root, symlinks=True)
    road, _ = walk(survey, root, "publish.overview_echoes=3000")
    assert not road.failures and not (root / "store" / "overview").exists()
    echoes = echoes_of(root)
    lowest = np.argsort(echo_hashes(Table({n: echoes[n] for n in IDENTITY})))[:3000]
    assert identities(root / "laz" / "overview.copc.laz") == who(*(echoes[n][lowest] for n in IDENTITY))


def test_other_overviews_leave_the_tiles_alone(several: Path, survey: Path) -> None:
    road, _ = walk(survey, several, *SMALL[:1], "publish.overview_echoes=4000")
    made = {stage for (stage, _), outcome in road.outcomes.items() if outcome.status == "computed"}
    assert made - {"publish-catalogue"} == {"overview", "publish-overview"}
    assert len(laspy.read(several / "laz" / "overview.copc.laz").points) == 4000
