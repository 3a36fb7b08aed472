"""Receipts and tables of a run that were written by another, with digests that fit: words, not tracebacks."""

from __future__ import annotations

import json

import numpy as np
import pytest
from commandline import fwclass
from runmaker import rewrite_table
from smallsurvey import deliver, small_survey

from fwclass.errors import DamagedError
from fwclass.store.cells import digest_within
from fwclass.store.receipts import Receipt


@pytest.mark.parametrize("cells", ["x", 7, [], {"size": 1, "first": 3, "rows": 1, "digests": ""}, {"names": 3}])
def test_what_a_part_has_where_is_of_its_kind_or_told(cells) -> None:
    receipt = Receipt("tile", "1_1", "0" * 24, {}, {}, "0" * 32, "store", {"cells": cells})
    with pytest.raises(DamagedError, match="cannot be used") as fault:
        digest_within(receipt, "1_1" if cells != {"size": 1, "first": 3, "rows": 1, "digests": ""} else (0, 0, 1, 1))
    assert "tile/1_1" in str(fault.value)


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
    assert ended.returncode == 1 and "cannot be used" in ended.stderr and "Traceback" not in ended.stderr
