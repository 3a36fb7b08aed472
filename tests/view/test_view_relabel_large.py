"""Relabelling a run whose coarse levels come from the overview, and what a folder says of it afterwards."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from drawn import box, drawn, drawn_classes, marked
from smallsurvey import deliver

from fwclass import conf
from fwclass.delivery.exported import ExportedRun
from fwclass.delivery.opened import open_run
from fwclass.delivery.viewed import ViewedRun
from fwclass.delivery.viewed_large import OverviewRun
from fwclass.delivery.viewed_open import OpenRun
from fwclass.schema import IDENTITY
from fwclass.store.corrections import CORRECTIONS
from fwclass.view.pyramid import Node
from fwclass.view.selection import Selection

WIDE = box(500_003, 5_400_002, 500_077, 5_400_038)
"""Over all eight tiles."""
SMALL = ("view.block=1000", "view.together=1000")


@pytest.fixture
def both(small_run: Path, tmp_path: Path) -> tuple[ViewedRun, ViewedRun]:
    """The same run twice: one is read whole, of the other the overview is."""
    other = shutil.copytree(small_run, tmp_path / "other", symlinks=True)
    plain = ViewedRun(open_run(small_run), conf.section("view", SMALL))
    large = ViewedRun(open_run(other), conf.section("view", (*SMALL, "view.whole=0")))
    assert type(plain.open) is OpenRun and type(large.open) is OverviewRun
    assert 0 <= large.pyramid.coarse < large.pyramid.own and "row" not in large.open.coarse().columns
    return plain, large


def who(scene: ViewedRun, node: Node, row: int) -> tuple[int, ...]:
    opened = scene.open.holder(node)
    at = opened.order[opened.nodes[node][0] + row]
    return tuple(int(opened.columns[n][at]) for n in IDENTITY)


def by_echo(scene: ViewedRun, data: bytes) -> dict[tuple[int, ...], tuple[Node, int]]:
    """Node and byte of every echo of marks."""
    out = {who(scene, node, r): (node, v) for node, rows in marked(data).items() for r, v in rows.items()}
    assert len(out) == sum(map(len, marked(data).values()))
    return out


def classes(scene: ViewedRun) -> dict[tuple[int, ...], int]:
    """Class of every echo, as its block has it."""
    return {who(scene, node, k): c for node, codes in drawn_classes(scene).items() for k, c in enumerate(codes)}


def rows_of(scene: ViewedRun) -> list[tuple[float, ...]]:
    """What was written, but for the time."""
    table = pq.read_table(scene.delivery.root / CORRECTIONS).to_pandas()
    return sorted(map(tuple, table[[*IDENTITY, "x", "y", "z", "class"]].fillna(-1).to_numpy().tolist()))


@pytest.mark.parametrize("named", [{}, {"classes": [2], "confidence": [0.5, 1.0]}], ids=["all", "filtered"])
def test_a_large_run_is_relabelled_as_a_small_one(both: tuple[ViewedRun, ViewedRun], named: dict[str, object]) -> None:
    plain, large = both
    told = [s.relabel.select(Selection.of(drawn(WIDE, **named))) for s in both]
    assert told[0] == told[1] and told[0]["tiles"] == 8 and told[0]["echoes"] > 1000
    marks = [by_echo(s, s.relabel.marks(told[0]["selection"])) for s in both]
    assert marks[0] == marks[1] and len(marks[0]) == told[0]["echoes"]
    assert sum(node[0] < large.pyramid.own for node, _ in marks[1].values()) > 100  # coarse ones are among them
    written = [s.relabel.correct(told[0]["selection"], 5) for s in both]
    assert written[0]["echoes"] == written[1]["echoes"] > 0
    assert rows_of(plain) == rows_of(large)
    shown = classes(large)
    assert classes(plain) == shown and {shown[echo] for echo in marks[1]} == {5}
    changes = [by_echo(s, s.relabel.changes(0)[8:]) for s in both]
    assert changes[0] == changes[1] and {v for _, v in changes[1].values()} == {5}
    node, row = min((n, r) for n, rows in marked(large.relabel.marks(told[1]["selection"])).items() for r in rows)
    assert node[0] < large.pyramid.own and large.echo(node, row)["corrected"] == 5
    for s, w in zip(both, written, strict=True):
        assert s.relabel.revert(w["time"])["standing"] == 0
    assert rows_of(plain) == rows_of(large)


def test_a_new_delivery_of_a_large_run_is_opened_as_a_large_one(small_run: Path) -> None:
    large = ViewedRun(open_run(small_run), conf.section("view", (*SMALL, "view.whole=0")))
    deliver(small_run.parent, "publish.figure_pixels=201")
    new = large.reopened()
    assert type(new.open) is OverviewRun and new.name != large.name
    assert new.relabel.select(Selection.of(drawn(WIDE)))["echoes"] > 1000


def test_an_exported_run_knows_what_was_corrected(small_run: Path) -> None:
    """Also what is corrected while it is written."""
    scene = ExportedRun(open_run(small_run), conf.section("view", (*SMALL, "view.unsure=1")))
    key = next(iter(scene.tiles))
    assert "corrected" in scene.colours() and not scene.columns.of_tile(key, "corrected").any()
    told = scene.relabel.select(Selection.of(drawn(WIDE)))
    scene.relabel.correct(told["selection"], 5)
    assert (
        np.isin(scene.columns.of_tile(key, "corrected"), (0, 1, 2)).all()
        and scene.columns.of_tile(key, "corrected").any()
    )
    assert any(one.about["corrected"] == 5 for place in scene.unsure_echoes() for one in place)
