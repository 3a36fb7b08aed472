"""Sharing out work to the cores of a process (`fwclass.cores`)."""

from __future__ import annotations

import runpy
import threading
import time

import numpy as np
import pytest
from defaults import BASE

from fwclass import cores
from fwclass.features import spheres
from fwclass.features.params import FeaturesParams
from fwclass.features.stage import features
from fwclass.grid import TileGrid
from fwclass.schema import Table
from fwclass.stage import Chunk

NAMES = (
    "planarity_r100",
    "height_range_r100",
    "height_above_p50_c200",
    "echo_ratio_r100",
    "linearity_opt",
    "optimal_radius",
)


@pytest.fixture
def three(monkeypatch):
    monkeypatch.setattr(cores, "_cores", 3)


def at_once(done: list[tuple[int, int]]):
    """A `begin` whose work waits until all three threads have begun."""
    together = threading.Barrier(3, timeout=20)

    def begin():
        def work(item):
            if 1 <= item <= 3:
                together.wait()
            done.append((item, threading.get_ident()))

        return work

    return begin


def test_every_item_is_done_once_and_the_cores_at_the_same_time(three):
    done: list[tuple[int, int]] = []
    cores.share_out(range(10), at_once(done))
    assert sorted(item for item, _ in done) == list(range(10))
    assert done[0] == (0, threading.get_ident())  # before others begin: it may have to be compiled


@pytest.mark.parametrize("items", [0, 1, 2])
def test_few_items_are_done_by_one(three, items):
    done: list[tuple[int, int]] = []
    cores.share_out(range(items), lambda: lambda item: done.append((item, threading.get_ident())))
    assert done == [(item, threading.get_ident()) for item in range(items)]


def test_without_a_word_there_is_one_thread():
    threads, own = set(), runpy.run_path(str(cores.__file__))  # another test may have said it to this process
    own["share_out"](range(5), lambda: lambda item: threads.add(threading.get_ident()))
    assert threads == {threading.get_ident()}


@pytest.mark.parametrize("where", ["here", "elsewhere"])
def test_after_a_fault_nothing_more_is_begun(three, where):
    begun, together, here = [], threading.Barrier(3, timeout=20), threading.get_ident()

    def work(item):
        begun.append(item)
        if 1 <= item <= 3:
            together.wait()
            if (threading.get_ident() == here) == (where == "here"):
                raise MemoryError("no room")
            time.sleep(0.2)

    with pytest.raises(MemoryError):
        cores.share_out(range(1000), lambda: work)
    assert len(begun) < 10


@pytest.mark.parametrize("most", [2_000, 20_000_000])
def test_features_are_the_same_on_all_cores(three, monkeypatch, most):
    rng = np.random.default_rng(1)
    x, y, z = rng.uniform(0, (20.0, 20.0, 5.0), (4000, 3)).T.round(3)
    noise = rng.uniform(size=4000) < 0.01
    table = Table({"x": x, "y": y, "z": z, "noise": noise, "number_of_echoes": np.ones(4000, np.uint8)})
    chunk = Chunk(table, np.arange(4000), TileGrid(100.0).tile("0_0"))
    params = FeaturesParams(**BASE["features"])
    monkeypatch.setattr(spheres, "AT_A_TIME", most)
    shared = features(chunk, NAMES, params)
    monkeypatch.setattr(cores, "_cores", 1)
    for name, values in features(chunk, NAMES, params).items():
        np.testing.assert_array_equal(shared[name], values, err_msg=name)
