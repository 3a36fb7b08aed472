"""`fwclass seams`: a strip along tile borders is the same in other tiles, and what is not is told."""

import hashlib
import json
import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from runmaker import SETTINGS, rewrite_table, walk

from fwclass import conf
from fwclass.errors import ConfigError, QualityError, StoreError
from fwclass.features.names import FeatureRequest as Features
from fwclass.operate.seams.differ import Seam, differs
from fwclass.operate.seams.shifted_squares import choose_squares, shift_of, shifted_squares
from fwclass.operate.seams.summary import as_data, as_text
from fwclass.operate.seams.walk import SeamRequest, seams
from fwclass.operate.status.walk import Silent, look_at
from fwclass.run.inputs import PartInputs
from fwclass.store.lock import writer
from fwclass.store.run_store import Store
from fwclass.store.tables import read_table
from fwclass.workflows import WORKFLOWS

CHECK = ("seams.width=4", "seams.share=1")
SMALL = "tile.size=30"


def measured(survey, root, *settings, shift=(50.0, 50.0), tiles=None):
    config = conf.load("demo", (*SETTINGS, f"survey.directory={survey}", *CHECK, *settings))
    return seams(config, root, SeamRequest(shift, config.seams.share, None, tiles), Silent())


@pytest.fixture
def copy(finished, tmp_path):
    shutil.copytree(finished[0], tmp_path / "copy", symlinks=True)
    return tmp_path / "copy"


def state(root):
    """Every file with its bytes and time, and every directory with its time."""
    found = {}
    for path in sorted(root.rglob("*")):
        bytes_ = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
        found[str(path)] = (bytes_, path.stat().st_mtime_ns)
    return found


def damage(root, stage, change):
    """Put ``change(part, table)`` in place of the table of every part of `stage`, so that no receipt tells."""
    for path in (root / "store" / stage).glob("*/receipt.json"):
        rewrite_table(path.parent, partial(change, path.parent.name))


def test_a_run_has_no_seams_and_is_left_as_it_is(survey, finished):
    many = finished[0]
    before = state(many)
    found = measured(survey, many)
    assert state(many) == before
    assert found.equal
    found.judge()
    stages = {s.stage: s for s in found.bounded}
    assert list(stages) == ["features", "radiometry", "label", "classify", "ground", "height", "terrain"]
    assert all(s.rows > 1000 for s in found.bounded)
    assert {"classification", "confidence"} <= set(stages["classify"].columns)
    assert len(stages["features"].columns) > 60 and set(stages["ground"].columns) == {"ground", "noise"}
    assert found.length == found.borders == pytest.approx(400.0)
    near = as_data(found, 1.0)
    assert near["equal"] and json.dumps(near, allow_nan=False)
    assert "no value differs" in as_text(found, 1.0)
    assert [a.stage for a in found.moved] == ["ground", "height"] and all(a.echoes for a in found.moved)


def test_another_shift_and_other_strips_are_as_equal(survey, finished):
    found = measured(survey, finished[0], "seams.seed=2", "seams.share=0.2", shift=(-61.5, 0.25))
    assert found.equal and 0 < found.length < found.borders


@pytest.mark.slow
def test_a_thinned_run_has_no_seams(survey, tmp_path):
    thinned = ("thin.rate=0.3", SMALL)
    road, _ = walk(survey, tmp_path, *thinned)
    assert not road.failures
    found = measured(survey, tmp_path, *thinned, "seams.share=0.3", shift=(15.0, 15.0))
    assert found.equal and "thin" in {s.stage for s in found.bounded}


def test_damaged_values_are_found_and_told(survey, copy):
    def other_class(part, table):
        codes = table["classification"].copy()
        codes[::10] = 6 + (codes[::10] == 6)
        return table.with_columns({"classification": codes})

    damage(copy, "classify", other_class)
    damage(copy, "radiometry", lambda part, table: table.with_columns({"range": table["range"] + 0.25}))
    found = measured(survey, copy)
    wrong = {s.stage: s for s in found.bounded if s.differ}
    assert set(wrong) == {"classify", "radiometry"}
    share = wrong["classify"].differ / wrong["classify"].rows
    assert 0.05 < share < 0.2
    assert wrong["radiometry"].columns["range"].worst == pytest.approx(0.25, abs=1e-3)
    one = as_data(found, 1.0)["bounded"]
    told = next(s for s in one if s["stage"] == "classify")
    assert told["where"] and told["examples"][0]["column"] == "classification"
    with pytest.raises(QualityError, match="classify: ") as fault:
        found.judge()
    assert fault.value.exit_code == 4
    assert "values differ" in as_text(found, 1.0) and "classification" in as_text(found, 1.0)


def test_the_ground_is_compared_in_its_blocks_and_in_others(survey, copy):
    damage(copy, "ground", lambda part, table: table.with_columns({"ground": ~table["ground"]}))
    damage(
        copy,
        "height",
        lambda part, table: table.with_columns({"height_above_ground": table["height_above_ground"] + 1}),
    )
    found = measured(survey, copy, "seams.share=0.1")
    wrong = {s.stage: s for s in found.bounded}
    assert wrong["ground"].differ == wrong["ground"].rows and wrong["ground"].columns["noise"].differ == 0
    height = wrong["height"].columns["height_above_ground"]
    assert height.differ > 0.9 * wrong["height"].rows and height.worst >= 1.0
    ground, above = found.moved
    assert (ground.stage, ground.off) == ("ground", ground.echoes) and ground.worst is None
    assert above.off > 0.9 * above.echoes > 0 and above.worst >= 1.0 and above.within == 0.01
    assert "have another flag (100" in as_text(found, 1.0)


def test_a_halo_too_small_is_found(survey, copy, tmp_path, monkeypatch):
    """Features as they come out if a tile reads its neighbours less far than they reach."""
    config = conf.load("demo", (*SETTINGS, f"survey.directory={survey}"))
    with monkeypatch.context() as patch:
        patch.setattr(Features, "reach", lambda self, params: 0.3)
        looked = look_at(copy, lambda road: WORKFLOWS["classification"](config, road))

    def near_sighted(part, table):
        (tmp_path / part).mkdir()
        looked.tasks["features", part].work(PartInputs(Store(copy)), tmp_path / part)
        return read_table(tmp_path / part / "table.parquet")

    damage(copy, "features", near_sighted)
    found = measured(survey, copy)
    wrong = {s.stage: s for s in found.bounded if s.differ}
    assert set(wrong) == {"features"}  # the others are made from what the features should be
    assert wrong["features"].differ > 0.1 * wrong["features"].rows


def test_what_is_not_finished_or_being_written_is_refused(survey, copy, tmp_path):
    with writer(copy), pytest.raises(StoreError, match="is writing"):
        measured(survey, copy)
    with pytest.raises(StoreError, match="not finished"):
        measured(survey, copy, "train.trees=9")
    with pytest.raises(StoreError, match="no run directory"):
        measured(survey, tmp_path / "none")
    shutil.rmtree(next((copy / "store" / "classify").iterdir()))
    with pytest.raises(StoreError, match="not finished"):
        measured(survey, copy)
    shutil.rmtree(copy / "store" / "tile")
    with pytest.raises(StoreError, match="not finished"):
        measured(survey, copy)


@pytest.mark.slow
def test_a_run_of_some_tiles_is_judged_by_these(survey, tmp_path):
    keys = frozenset(("17066_180100", "17067_180100"))
    road, _ = walk(survey, tmp_path, SMALL, tiles=keys)
    assert not road.failures
    found = measured(survey, tmp_path, SMALL, shift=(15.0, 15.0), tiles=keys)
    assert found.equal and found.borders == pytest.approx(30.0)
    with pytest.raises(ConfigError, match="share a border"):
        measured(survey, tmp_path, SMALL, tiles=frozenset(["17067_180100"]))


def test_differences_are_counted_to_the_bit():
    a = np.array([0.0, 1.0, np.nan, np.nan, 5.0, np.inf], np.float32)
    b = np.array([-0.0, np.nextafter(np.float32(1), 2), np.nan, 2.0, 5.0, np.inf], np.float32)
    assert differs(a, b).tolist() == [True, True, False, True, False, False]
    assert differs(np.array([True, False]), np.array([True, True])).tolist() == [False, True]
    seam = Seam("x", "block", "cells", 0)
    seam.add("p", {"a": a}, {"a": b}, None)
    column = seam.columns["a"]
    assert (seam.rows, seam.differ, column.differ, column.one_sided) == (6, 3, 3, 1)
    assert column.worst == pytest.approx(1.2e-7, rel=0.1)


def test_places_hold_all_that_is_near_a_border_once():
    r = np.random.default_rng(1)
    x, y = np.round(r.uniform(0, 40, (2, 20_000)), 3)
    keys = [f"{i}_{j}" for i in range(4) for j in range(4) if (i, j) != (2, 1)]
    here = shifted_squares(keys, 10.0, (5.0, 3.0), 1.0)
    held = np.zeros(len(x), int)
    for square in here:
        inside = square.holds(x, y)
        assert square.tile.box.contains(x[inside], y[inside]).all()
        held += inside
    cell = {(int(k.split("_")[0]), int(k.split("_")[1])) for k in keys}
    near = np.zeros(len(x), bool)
    for k in range(len(x)):
        i, j = int(x[k] // 10), int(y[k] // 10)
        for axis, at, step in ((0, x[k], (1, 0)), (1, y[k], (0, 1))):
            edge = round(at / 10) * 10
            if 0 < edge < 40 and edge - 1 <= at < edge + 1:
                low = (edge // 10 - 1, j) if axis == 0 else (i, edge // 10 - 1)
                near[k] |= low in cell and (low[0] + step[0], low[1] + step[1]) in cell
    assert (held == near).all()
    assert sum(p.length for p in here) == pytest.approx(10.0 * (24 - 4))


def test_borders_are_drawn_by_share_length_and_seed():
    keys = [f"{i}_{j}" for i in range(10) for j in range(10)]
    here = shifted_squares(keys, 100.0, (50.0, 50.0), 5.0)
    total = sum(p.length for p in here)
    assert total == pytest.approx(18_000.0)
    some = choose_squares(here, 0.1, None, 1)
    assert 1_800 <= sum(p.length for p in some) < 2_000
    assert some == choose_squares(here[::-1], 0.1, None, 1) != choose_squares(here, 0.1, None, 2)
    assert len(choose_squares(here, 0.1, 1.0, 1)) == 1 and len(choose_squares(here, 1.0, None, 1)) == len(here)
    assert replace(some[0]) in here


def test_a_shift_moves_the_grid_or_is_refused():
    assert shift_of(None, 30.0) == (15.0, 15.0) and shift_of("7.5, -2", 30.0) == (7.5, -2.0)
    for text in ("0,0", "30,-60", "5", "a,b", "1,2,3", "nan,1", "inf,0"):
        with pytest.raises(ConfigError, match="not a shift"):
            shift_of(text, 30.0)
