"""Receipts and tables of a run that were written by another, with digests that fit: words, not tracebacks."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commandline import fwclass
from runmaker import rewrite_table
from smallsurvey import deliver, small_survey

from fwclass.classes import counts_of
from fwclass.errors import DamagedError
from fwclass.graph.stages import STAGES
from fwclass.store.metas import META
from fwclass.store.receipts import Receipt
from fwclass.store.row_digests import digest_within
from fwclass.store.run_store import Store

INDEX = {"spans": [[0, 9, 0, 4, []]], "points": 9, "pulses": 4, "point_format": 4, "from_outgoing": False}
FACTS = {"points": 0, "bounds": [0.0] * 6, "confidence": None, "times": None, "classes": {}, "sure": {}, "figures": {}}


def receipt_of(stage: str, meta: dict[str, Any]) -> Receipt:
    """The receipt as it is read where a file lies that tells `meta`."""
    written = Receipt(stage, "1_1", "0" * 24, {}, {}, "0" * 32, "store", meta)
    return Receipt.from_json(json.loads(written.to_text()), "receipt.json")


@pytest.mark.parametrize("cells", ["x", [], 0.5, {"size": 1, "first": 3, "rows": 1, "digests": ""}, {"names": 3}])
def test_what_a_part_has_where_is_of_its_kind_or_told(cells) -> None:
    with pytest.raises(DamagedError, match="no digests of pieces") as fault:
        digest_within(receipt_of("own", {"cells": cells}), "1_1")
    assert "own/1_1" in str(fault.value) and "meta.cells" in fault.value.expected


@pytest.mark.parametrize(
    ("change", "at", "expected", "got"),
    [
        ({"points": "many"}, "meta.points", "a count", "'many'"),
        ({"points": -1}, "meta.points", "a count", "-1"),
        ({"points": True}, "meta.points", "a count", "True"),
        ({"pulses": 1e300}, "meta.pulses", "a count", "1e+300"),
        ({"pulses": 10**18}, "meta.pulses", "a count", "1" + "0" * 18),
        ({"spans": [[0, 9, 0, 4]]}, "meta.spans.0", "a list of 5", "[0, 9, 0, 4]"),
        ({"spans": [[0, 9, 0, 4, [None]]]}, "meta.spans.0.4.0", "a whole number of 64 bits", "None"),
        ({"sensor": [1.0]}, "meta.sensor", "a list of 2", "[1.0]"),
        ({"spans": {"a": 1}}, "meta.spans", "a list", "{'a': 1}"),
        ({"spans": "a" * 999}, "meta.spans", "a list", "'" + "a" * 79 + "…"),
    ],
)
def test_a_receipt_that_tells_something_else_is_told_by_place_and_value(change, at, expected, got) -> None:
    receipt = receipt_of("index", {**INDEX, **change})
    with pytest.raises(DamagedError, match="something else than its stage") as fault:
        list(receipt.meta)
    assert (fault.value.where, fault.value.expected, fault.value.got) == ("receipt.json", f"{at}: {expected}", got)


@pytest.mark.parametrize(
    ("stage", "meta", "expected"),
    [
        ("confusion", {"matrix": [[1, 2]], "lost": [0]}, "a square matrix"),
        ("trajectory", {"fixes": 3, "begins": [], "ends": 1.0}, "at least one"),
        ("vector-cell", {"density": 1.0, "cell": 0.0, "sparse": False}, "a number above 0"),
        ("radiometry", {"sums": {"x": []}, "without_range": 0, "pointing_error": None}, "a whole number as text"),
        ("classify", {"codes": {"256": 1}}, "a class code as text"),
        ("ground-filter", {"pieces": [["../x", 1]]}, "the key of a tile, as 12_34"),
        ("tile", {"rows": 1, "blocks": {"0.0": []}}, "a number above 0 as text"),
        ("publish-tile", {"beyond": {}, "facts": FACTS, "percent": None}, "to be there"),
    ],
)
def test_lengths_keys_and_bounds_are_told_too(stage: str, meta: dict[str, Any], expected: str) -> None:
    whole = {"ground-filter": ("rows", "ground", "noise", "seen", "last"), "publish-tile": ("rows",)}
    counts = dict.fromkeys(whole.get(stage, ()), 0)
    with pytest.raises(DamagedError) as fault:
        dict(receipt_of(stage, counts | meta).meta)
    assert fault.value.expected.endswith(f": {expected}")


def test_times_are_what_files_have() -> None:
    """A file's GPS times may be any number that is finite."""
    told = {"fixes": 2, "begins": [-1.7e308, 1e300], "ends": 1.7e308}
    assert dict(receipt_of("trajectory", told).meta) == told


@pytest.mark.parametrize("counts", [[], [[1, 2]], [[1, 2], [3]], [[1, 2, 3]] * 3])
def test_counts_of_other_classes_than_the_run_has_are_told(counts) -> None:
    assert counts_of([[1, 2], [3, 4]], (2, 2), "matrices").tolist() == [[1, 2], [3, 4]]
    assert counts_of([], (0, 2), "boxes").shape == (0, 2)
    with pytest.raises(DamagedError, match="matrices do not belong to the classes"):
        counts_of(counts, (2, 2), "matrices")


def test_numbers_that_are_none_fit_nothing() -> None:
    plain = json.loads(receipt_of("trajectory", {"fixes": 1, "begins": [0.0], "ends": 1.0}).to_text())
    del plain["seal"]
    for value in (float("nan"), float("inf"), 10**400):
        plain["meta"]["ends"] = value
        with pytest.raises(DamagedError, match="a finite number"):
            dict(Receipt.from_json(plain, "receipt.json").meta)


def test_a_receipt_that_nobody_asks_tells_nothing_wrong() -> None:
    """One of another version is known by its key: it is made anew, whatever it told."""
    assert receipt_of("index", {"spans": 7}).key == "0" * 24


def test_a_name_that_no_stage_tells_is_a_fault_of_the_program() -> None:
    meta = receipt_of("index", {n: v for n, v in INDEX.items() if n != "from_outgoing"}).meta
    assert meta.get("from_outgoing") is None and "from_outgoing" not in meta and dict(meta)["points"] == 9
    with pytest.raises(DamagedError, match="lacks what its stage tells"):
        meta["from_outgoing"]
    with pytest.raises(KeyError, match="pionts"):
        meta["pionts"]


def test_a_stage_that_tells_something_else_is_a_fault_of_the_program(tmp_path: Path) -> None:
    """Or receipts would be written that nobody can read."""

    def work(meta: dict[str, Any]) -> Callable[[Path], dict[str, Any]]:
        return lambda directory: meta

    store = Store(tmp_path)
    with pytest.raises(TypeError, match=r"stage index tells meta\.points = None, expected a count"):
        store.commit("index", "00000", "0" * 24, {}, "store", work({**INDEX, "points": None}))
    assert store.commit("index", "00000", "0" * 24, {}, "store", work(INDEX)).meta == INDEX
    assert dict(Store(tmp_path).receipt("index", "00000").meta) == INDEX


def test_every_shape_is_of_a_stage() -> None:
    assert META.keys() <= {stage.name for stage in STAGES}


@pytest.mark.slow
def test_a_forged_run_is_refused_in_words(tmp_path) -> None:
    """Spans that are none, and a table of half of its rows."""
    survey = small_survey(tmp_path)
    deliver(tmp_path)
    words = ("run", survey, "--out", tmp_path / "run", "--workers", 0, "--set", "train.trees=6")
    place = next((tmp_path / "run" / "store" / "classify").iterdir())
    rewrite_table(place.parents[1] / "tile" / place.name, lambda table: table.take(np.arange(table.rows // 2)))
    ended = fwclass(*words)
    assert ended.returncode == 3 and "other rows than its tile" in ended.stderr and "traceback" not in ended.stderr
    path = next((tmp_path / "run" / "store" / "index").glob("*/receipt.json"))
    receipt = json.loads(path.read_text())
    receipt["meta"]["spans"] = 7
    del receipt["seal"]
    path.write_text(json.dumps(receipt))
    ended = fwclass(*words)
    assert ended.returncode == 1 and "Traceback" not in ended.stderr
    assert "expected: meta.spans: a list\n  got: 7" in ended.stderr and str(path) in ended.stderr
