"""`--workflow li2018` from the command line, on six metres of simulated street: figures that belong together, a page,
and a second run that makes nothing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import cast

import pytest
from browser import seen
from commandline import fwclass

from fwclass import conf
from fwclass.errors import ConfigError
from fwclass.run.runner import Runner
from fwclass.study.papers.claims import FAILS, HOLDS, OPEN

SMALL = (
    "street_scene.length=6",
    "papers.test_echoes=5000",
    "train.samples_per_class=300",
    "compare.rbf_svm.search_rows=200",
    "compare.rbf_svm.max_rows=600",
    "compare.rbf_svm.c=[10.0]",
    "compare.rbf_svm.gamma=[0.1]",
)


def test_what_the_page_would_not_heed_is_refused() -> None:
    """Averaged shares were set, and every figure was without."""
    from workflows.li2018 import walk

    with pytest.raises(ConfigError, match="decide alone"):
        walk(conf.load("street-sim", ("street.smooth=0.3",)), cast(Runner, None))


@pytest.mark.slow
def test_the_run_and_its_page(tmp_path: Path) -> None:
    words = ("run", "street-sim", "--workflow", "li2018", "--out", tmp_path / "li", "--workers", "0")
    words += tuple(w for s in SMALL for w in ("--set", s))
    ended = fwclass(*words)
    assert ended.returncode == 0, ended.stderr
    facts = json.loads((tmp_path / "li" / "li2018.json").read_text())
    assert [r["radius"] for r in facts["radii"]] == facts["printed"]["radii"] and len(facts["singles"]) == 11
    assert facts["best"] == min(facts["radii"], key=lambda r: r["other"]["error"])["radius"]
    for radius in facts["radii"]:
        for split in ("random", "other", "leafless"):
            told = radius[split]
            (right, missed), (false, others) = told["confusion"]
            total = right + missed + false + others
            assert 1000 < total <= 5500 and told["error"] == pytest.approx((missed + false) / total)
            assert told["detection"] == pytest.approx(right / (right + missed))
            assert told["false_alarm"] == pytest.approx(false / (false + others))
            assert told["error"] < min(right + missed, false + others) / total or split == "leafless"
    assert {c["verdict"] for c in facts["claims"]} <= {HOLDS, FAILS, OPEN}
    page = (tmp_path / "li" / "li2018.html").read_text(encoding="utf-8")
    assert all(c["claim"] in page for c in facts["claims"]) and "<script" not in page
    for width in (1280, 390):
        assert seen((tmp_path / "li" / "li2018.html").resolve(), width).width <= width
    again = fwclass(*words)
    assert again.returncode == 0 and "computed" not in again.stderr, again.stderr
