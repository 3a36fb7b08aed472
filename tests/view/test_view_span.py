"""Colours of numbers: what they span, which a stray echo does not flatten, and what the page says of it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from pagedriver import Driven, driven
from smallsurvey import deliver, small_survey
from viewedpage import opened, served, text

from fwclass import conf
from fwclass.delivery.opened import open_run
from fwclass.delivery.viewed import ViewedRun
from fwclass.delivery.viewed_columns import ColourSpan


def test_a_stray_value_flattens_no_colour_and_the_ends_know_of_it() -> None:
    values = np.linspace(100.0, 140.0, 4001)
    plain, strayed = ColourSpan.over(values), ColourSpan.over(np.append(values, [-9000.0, 9000.0]))
    assert plain.low == pytest.approx(100.4, abs=0.02) and plain.high == pytest.approx(139.6, abs=0.02)
    assert [strayed.low, strayed.high] == pytest.approx([plain.low, plain.high], abs=0.05)
    assert (strayed.least, strayed.most) == (-9000, 9000)


def test_few_values_flags_and_none_span_what_they_have() -> None:
    assert ColourSpan.over(np.array([3.0, 1.0, 2.0])) == ColourSpan(1, 3, 1, 3)
    assert ColourSpan.over(np.r_[np.zeros(9999), 1.0]) == ColourSpan(0, 1, 0, 1)  # a flag that one in 10 000 has
    assert ColourSpan.over(np.full(5, 7.0)) == ColourSpan(7, 7, 7, 7)
    assert all(map(math.isnan, vars(ColourSpan.over(np.empty(0))).values()))


def test_two_runs_span_what_either_has_and_none_counts_for_nothing() -> None:
    none = ColourSpan.over(np.empty(0))
    assert ColourSpan.joined([ColourSpan(1, 5, 0, 9), ColourSpan(2, 6, -1, 6), none]) == ColourSpan(1, 6, -1, 9)
    assert math.isnan(ColourSpan.joined([none, none]).low)


@pytest.mark.parametrize("together", [1000, 400_000], ids=["few coarse echoes", "all of them"])
def test_what_blocks_have_spans_its_hundredths(run: Path, together: int) -> None:
    """Of the coarse echoes, which are of all tiles, or of tiles where those are few."""
    delivery = open_run(run)
    scene = ViewedRun(delivery, conf.section("view", ("view.block=2000", f"view.together={together}")))
    table = delivery.echoes().to_pandas()
    for name in ("z", "confidence", "height_above_ground", "intensity"):
        values = np.sort(table[name].dropna().to_numpy(float))
        about = scene.scale(name)
        for end, part in (("low", 0.01), ("high", 0.99)):
            first, last = (np.searchsorted(values, about[end], side) / len(values) for side in ("left", "right"))
            assert first - 0.008 <= part <= last + 0.008, (name, end)
        assert values[0] <= about["least"] <= about["low"] < about["high"] <= about["most"] <= values[-1]


def section(page: Driven) -> str:
    """What is said of one along the slope's southern edge, where the stray echo is."""
    page.run("Object.assign(fwclass.cam, {tilt: 1.5707, azimuth: 0, far: 100, target: [60, 10, 0]}); fwclass.moved()")
    page.until("fwclass.stats.settled")
    page.run(
        """(async () => { const { matrix, project } = await import('./camera.js'), v = document.getElementById('view');
        const w = v.clientWidth, h = v.clientHeight, o = fwclass.scenes()[0].origin, m = matrix(fwclass.cam, w / h);
        document.getElementById('width').value = 10; fwclass.tool('section');
        for (const x of [500045, 500075])
        fwclass.click(...project(m, [x - o[0], 5400000 - o[1], 203 - o[2]], w, h)); })()"""
    )
    page.until("fwclass.state.section && fwclass.stats.settled && !fwclass.state.section.stale")
    return text(page, "cut-says")


@pytest.mark.slow
def test_the_page_tells_heights_apart_beside_a_stray_echo(small_run: Path, tmp_path: Path) -> None:
    small_survey(tmp_path, stray=(-20.0, 3000.0), tile=25)
    deliver(tmp_path)
    looks, sections = [], []
    with driven() as page:
        for root in (small_run, tmp_path / "run"):
            with served(root) as server:
                opened(page, server, more="&by=height")
                looks.append((page.run("[fwclass.state.look.low, fwclass.state.look.high]"), text(page, "legend")))
                page.run("fwclass.colourBy('number_of_echoes')")  # which is 1 of all
                page.until("fwclass.stats.settled")
                assert text(page, "legend").split()[0] == "1" and page.faults == []
                sections.append(section(page))
    (plain, _), (strayed, words) = looks
    (plain_echoes, one), (strayed_echoes, other) = (words.split(" echoes", 1) for words in sections)
    assert int(strayed_echoes) == int(plain_echoes) + 1
    assert other == f"{one}; 1 echo far above or below is left out"
    assert strayed == pytest.approx(plain, abs=0.3) and plain[1] - plain[0] < 12
    assert words.startswith("≤ 200") and "≥ 20" in words
