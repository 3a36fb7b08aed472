"""A run that is not read whole: coarse levels from the delivered overview, rows looked up when they are asked for."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import lasmaker
import laspy
import numpy as np
import pytest
from smallsurvey import deliver, small_survey

from fwclass import conf
from fwclass.delivery.opened import open_run
from fwclass.delivery.viewed import ViewedRun
from fwclass.delivery.viewed_large import OVERVIEW, OverviewRun
from fwclass.delivery.viewed_open import OpenRun
from fwclass.errors import InputError
from fwclass.schema import IDENTITY
from fwclass.view.blocks import BYTES, HEAD
from fwclass.view.scene import ECHOES

SMALL = ("view.block=2000", "view.together=1000")


@pytest.fixture(scope="module")
def plain(run: Path) -> ViewedRun:
    scene = ViewedRun(open_run(run), conf.section("view", SMALL))
    assert type(scene.open) is OpenRun
    return scene


@pytest.fixture(scope="module")
def large(run: Path) -> ViewedRun:
    scene = ViewedRun(open_run(run), conf.section("view", (*SMALL, "view.whole=0")))
    assert type(scene.open) is OverviewRun and "row" not in scene.open.coarse().columns
    return scene


def blocks(level: bytes, stride: int) -> dict[tuple[int, ...], np.ndarray]:
    out, at = {}, 0
    while at < len(level):
        size, *node, count = struct.unpack_from("<5I", level, at)
        planes = zlib.decompress(level[at + HEAD.size : at + HEAD.size + size])
        out[tuple(node)] = np.frombuffer(planes, np.uint8).reshape(stride, count)
        at += HEAD.size + size
    return out


@pytest.mark.slow
def test_every_echo_is_drawn_once_and_what_is_coarse_is_bounded(large: ViewedRun) -> None:
    pyramid = large.pyramid
    assert 0 <= pyramid.coarse < pyramid.own - 1 and large.index()["together"] == list(range(pyramid.coarse + 1))
    levels = [blocks(large.level(ECHOES, k), BYTES) for k in pyramid.levels()]
    assert sum(b.shape[1] for level in levels for b in level.values()) == large.echoes
    assert all(not levels[k] for k in range(pyramid.coarse + 1, pyramid.own))
    assert large.open.coarse().order.size <= 2 * 1000 * 1.2


def test_the_overview_has_the_echoes_that_the_tiles_have(large: ViewedRun, plain: ViewedRun) -> None:
    """Node by node the same classes and strips; the places agree to the last bit, what is stored in steps to a step."""
    for level in large.index()["together"]:
        for part, stride in ((ECHOES, BYTES), ("strip", 1), ("right_or_wrong", 1), ("echo_ratio_r100", 1)):
            a, b = blocks(large.level(part, level), stride), blocks(plain.level(part, level), stride)
            assert a.keys() == b.keys()
            for node in a:
                rows = slice(10, 11) if part == ECHOES else slice(0, 1)
                assert sorted(a[node][rows].ravel()) == sorted(b[node][rows].ravel()), (part, node)
    for name in ("x", "y", "z", "classification", "intensity", *IDENTITY, "confidence", "height_above_ground"):
        a, b = (s.open.coarse().columns for s in (large, plain))
        i, j = (np.lexsort([c[n] for n in IDENTITY]) for c in (a, b))
        rounded = name in ("confidence", "height_above_ground")  # in Parquet to 2^-11, in COPC to 0.01
        assert a[name].dtype == b[name].dtype
        np.testing.assert_allclose(a[name][i], b[name][j], rtol=rounded * 2**-11, atol=rounded * 0.0051)


def test_a_coarse_echo_is_the_one_of_its_tile(large: ViewedRun) -> None:
    opened = large.open.coarse()
    for node, (first, last) in list(opened.nodes.items())[::3]:
        for row in {0, last - first - 1}:
            told = large.echo(node, row)
            values, at = told["values"], opened.order[first + row]
            assert [values[n] for n in IDENTITY] == [opened.columns[n][at] for n in IDENTITY]
            assert [values[a] for a in "xyz"] == [opened.columns[a][at] for a in "xyz"]
            assert large.why(*(values[n] for n in IDENTITY))["shares"]


def test_the_first_picture_opens_no_tile(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = ViewedRun(open_run(run), conf.section("view", (*SMALL, "view.whole=0")))

    def refuse(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(scene.open, "columns", refuse)
    monkeypatch.setattr(scene.open, "read", refuse)
    assert sum(len(scene.level(ECHOES, k)) for k in scene.index()["together"]) > 5_000
    assert scene.level("strip", 0)


def test_what_is_read_for_the_coarse_levels_is_not_read_again(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, read = ViewedRun(open_run(run), conf.section("view", SMALL)), []
    columns = scene.open.read
    monkeypatch.setattr(scene.open, "read", lambda key: read.append(key) or columns(key))
    drawn = sum(b.shape[1] for k in scene.pyramid.levels() for b in blocks(scene.level(ECHOES, k), BYTES).values())
    assert drawn == scene.echoes and sorted(read) == sorted(scene.tiles)


def test_an_overview_that_does_not_know_its_pulses_is_said(run: Path, tmp_path: Path) -> None:
    """Its digest may fit: whoever can write the run can write its manifest."""
    delivery, other = open_run(run), tmp_path / "other.las"
    lasmaker.write_las(other, np.full((9, 3), 200.0), point_format=6)
    file = delivery.file
    delivery.file = lambda name: other if name == OVERVIEW else file(name)  # type: ignore[method-assign]
    scene = ViewedRun(delivery, conf.section("view", (*SMALL, "view.whole=0")))
    with pytest.raises(InputError, match="which pulses its echoes are of") as fault:
        scene.level(ECHOES, 0)
    assert "other.las" in str(fault.value) and "--verify" in str(fault.value)


def test_amplitudes_that_the_overview_leaves_out_are_the_intensities(tmp_path: Path) -> None:
    deliver(small_survey(tmp_path).parent)
    settings = ("view.block=2000", "view.together=1000", "view.whole=0")
    scene = ViewedRun(open_run(tmp_path / "run"), conf.section("view", settings))
    coarse = scene.open.coarse()
    assert type(scene.open) is OverviewRun and len(np.unique(coarse.columns["amplitude"])) > 2
    assert (coarse.columns["amplitude"] == coarse.columns["intensity"]).all()
    for path in ("laz/overview.copc.laz", next((tmp_path / "run/laz/tiles").iterdir())):
        names = list(laspy.read(tmp_path / "run" / path).point_format.extra_dimension_names)
        assert "pulse" in names and "amplitude DN" not in names, path
