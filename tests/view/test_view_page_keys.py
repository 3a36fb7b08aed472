"""The page without a mouse, and the section of two runs, in headless Chromium."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from pagedriver import Driven, driven
from smallsurvey import deliver
from viewedpage import PIXELS, SECTION, opened, served, text

from fwclass.delivery.viewed import ViewedRun
from fwclass.delivery.viewed_columns import span_of

pytestmark = pytest.mark.slow

HERE = "[fwclass.cross().x, fwclass.cross().y]"


@pytest.fixture(scope="module")
def browser_page() -> Iterator[Driven]:
    with driven() as page:
        yield page


def keys(page: Driven, *names: str) -> None:
    """Each pressed in turn; `name*n` n times, `+name` with shift."""
    for name in names:
        one, _, times = name.partition("*")
        for _ in range(int(times or 1)):
            for kind in ("keyDown", "keyUp"):
                bare = one.removeprefix("+")
                page.ask("Input.dispatchKeyEvent", type=kind, key=bare, modifiers=8 * (bare != one))


STEP = 0.005
"""m, that a block moves an echo at most."""


def in_strip(scene: ViewedRun, line: Any) -> list[int]:
    """Echoes of a run within the strip of a section, counted from its tables, fewest and most by how blocks round
    places; `line`: A, B, half the width."""
    (ax, ay), (bx, by), half = line
    total = [0, 0]
    for tile in scene.tiles:
        columns = scene.open.read(tile)
        x, y = columns["x"] - scene.origin[0] - ax, columns["y"] - scene.origin[1] - ay
        length = np.hypot(bx - ax, by - ay)
        along, across = (x * (bx - ax) + y * (by - ay)) / length, (x * (by - ay) - y * (bx - ax)) / length
        for k, by_ in enumerate((-STEP, STEP)):
            total[k] += int(((along >= -by_) & (along <= length + by_) & (np.abs(across) <= half + by_)).sum())
    return total


LONELIEST = """(() => {
  const near = (a, b) => Math.hypot(a.x - b.x, a.y - b.y), all = fwclass.state.section.echoes;
  const alone = (e) => Math.min(...all.filter((o) => o !== e).map((o) => near(e, o)));
  const e = all.reduce((a, b) => (alone(b) > alone(a) ? b : a));
  return [e.x, e.y, e.node.key, e.row];
})()"""
"""The echo of a section that no other one lies close to: a click rounds to pixels."""
LINE = "(({A, B, half}) => [A.slice(0, 2), B.slice(0, 2), half])(fwclass.state.section)"


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
def test_enter_at_the_crosshair_is_a_click_there(
    browser_page: Driven, small_run: Path, width: int, height: int
) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server, width, height)
        before = page.run("fwclass.cam.target")
        keys(page, "c", "ArrowRight*3", "+ArrowUp*4")
        shown = page.run(
            "(() => { const b = document.getElementById('cross').getBoundingClientRect(); return [b.x, b.y]; })()"
        )
        x, y = page.run(HERE)
        assert shown == [x, y] == [page.run("document.getElementById('view').clientWidth >> 1") + 30, y]
        assert page.run("fwclass.cam.target") == before  # the cloud stays
        keys(page, "Enter")
        page.until("fwclass.stats.echo")
        picked = page.run("[fwclass.state.selected.node.key, fwclass.state.selected.row]")
        page.run("fwclass.state.selected = null")
        page.click(x, y)
        assert page.run("[fwclass.state.selected.node.key, fwclass.state.selected.row]") == picked
        keys(page, "ArrowLeft*500")
        assert page.run(HERE) == [0, y]
        keys(page, "c")
        assert page.run("document.getElementById('cross').hidden")
        keys(page, "ArrowLeft")
        assert page.run("fwclass.cam.target") != before and page.faults == []


def test_section_measure_and_pick_in_the_section_without_a_mouse(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server)
        page.run("document.getElementById('section').focus()")
        keys(page, "s", "c", "ArrowLeft*15", "Enter", "ArrowRight*30", "Enter")
        page.until("fwclass.state.section?.echoes?.length > 20 && fwclass.stats.settled")
        fewest, most = in_strip(server.scenes[0], page.run(LINE))
        echoes = int(text(page, "cut-says").split()[0])
        assert fewest <= echoes <= most <= fewest + 9
        page.run("Object.assign(fwclass.cam, {far: 3}); fwclass.moved(); fwclass.state.section.stale = true")
        page.until("fwclass.stats.settled && !fwclass.state.section.stale")  # also of what the window does not show
        assert page.run("fwclass.state.section.echoes.length") == echoes
        keys(page, "0", "c")
        assert "takes it away" in text(page, "says")
        one = page.run(LONELIEST)
        x, y = page.run(HERE)
        for name, by in (("Right", round(one[0]) - x), ("Down", round(one[1]) - y)):
            keys(page, f"+Arrow{name if by > 0 else {'Right': 'Left', 'Down': 'Up'}[name]}*{abs(by)}")
        keys(page, "Enter")
        assert page.run("[fwclass.state.selected.node.key, fwclass.state.selected.row]") == one[2:]
        keys(page, "Escape")
        assert page.run("document.getElementById('cross').hidden && !document.getElementById('profile').hidden")
        keys(page, "Escape", "m", "c")
        for _ in range(60):
            keys(page, "Enter")
            if not page.run("fwclass.state.tool"):
                break
            keys(page, "ArrowRight")
        assert "sideways" in text(page, "says") and page.faults == []


def test_relabelling_without_a_mouse_selects_what_a_hand_does(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server)
        keys(page, "c", "r")
        page.until("fwclass.relabel().may")
        assert text(page, "count") == "Draw around echoes. Enter sets a corner, and the last one twice."
        x, y = page.run(HERE)
        keys(page, "Enter", "ArrowRight*9", "Enter", "ArrowDown*9", "Enter", "ArrowLeft*9")
        page.until("document.querySelector('#marks .lasso').getAttribute('d').split('L').length > 3")
        keys(page, "Escape", "ArrowRight*9", "ArrowUp*9", "ArrowLeft*9")
        page.until("!document.querySelector('#marks .lasso')")
        keys(page, "Enter", "ArrowRight*9", "Enter", "ArrowDown*9", "Enter", "ArrowLeft*9", "Enter", "Enter")
        page.until("fwclass.relabel().selection")
        told = text(page, "count")
        keys(page, "Escape")
        page.run(
            f"(() => {{ const r = fwclass.relabel(); r.where = 'cloud'; r.stroke = [[{x}, {y}], [{x + 90}, {y}], "
            f"[{x + 90}, {y + 90}], [{x}, {y + 90}]]; r.up(); }})()"
        )
        page.until("fwclass.relabel().selection")
        assert text(page, "count") == told
        page.run("document.getElementById('give').value = '6'; fwclass.relabel().steps()")
        keys(page, "Enter")
        page.until("/^Written/.test(document.getElementById('count').textContent)")
        keys(page, "b", "Enter", "Enter")
        page.until("fwclass.relabel().selection")
        keys(page, "Escape", "s", "ArrowLeft*9", "Enter", "ArrowRight*18", "Enter", "a")
        page.until("fwclass.state.section?.echoes?.length > 20")
        width = page.run("document.getElementById('cut').clientWidth")
        keys(page, "c", f"ArrowLeft*{width // 20}", "Enter", f"ArrowRight*{width // 10}", "Enter", "Enter")
        page.until("fwclass.relabel().selection")
        assert text(page, "count").split()[1].startswith("echo") and page.faults == []


def test_the_keys_are_told_in_the_page(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server, 390, 844)
        keys(page, "?")
        told = set(page.run("[...document.querySelectorAll('#help kbd')].map((e) => e.textContent)"))
        known = set(page.run("fwclass.keys()"))
        assert told - {"←", "→", "↑", "↓"} == (known - {"Escape"}) | {"Esc"}
        inside = "document.getElementById('help').getBoundingClientRect().top < innerHeight"
        assert page.run(inside) and page.run("document.documentElement.scrollWidth") == 390


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
def test_two_runs_have_the_same_strip_in_their_section_and_echoes_of_both_are_picked(
    browser_page: Driven, small_run: Path, width: int, height: int
) -> None:
    other = small_run.parent.parent / "again" / "run"
    shutil.copytree(small_run, other, symlinks=True)
    with served(small_run, other) as server:
        page = opened(browser_page, server, width, height)
        page.run(SECTION)
        page.until("fwclass.state.section?.echoes?.length > 20 && fwclass.stats.settled")
        said = re.match(r"survey/run: (\d+) echoes; again/run: (\d+) echoes; ", text(page, "cut-says"))
        assert said is not None
        for scene, echoes in zip(server.scenes, map(int, said.groups()), strict=True):
            fewest, most = in_strip(scene, page.run(LINE))
            assert 20 < fewest <= echoes <= most <= fewest + 9
        places = page.run("fwclass.state.section.echoes.map((e) => [e.of, e.s, e.z, e.x, e.y])")
        by_run = [np.array([p[1:] for p in places if p[0] == k]) for k in (0, 1)]
        order = [np.lexsort(p[:, :2].T) for p in by_run]
        moved = by_run[1][order[1]] - by_run[0][order[0]]
        assert np.allclose(moved, [0, 0, *moved[0, 2:]], atol=1e-6)  # one scale, and one direction
        assert np.abs(moved[0, 2:]).max() > 40
        for k, name in enumerate(("survey/run", "again/run")):
            x, y = by_run[k][9, 2:]
            box = page.run(
                "(() => { const b = document.getElementById('cut').getBoundingClientRect(); return [b.x, b.y]; })()"
            )
            page.click(box[0] + x, box[1] + y)
            page.until(f"document.getElementById('says').textContent.startsWith('{name}: ')")
        lines = page.run("document.querySelectorAll('#marks .over').length")
        assert lines == 2 and page.run(PIXELS) and page.faults == []
        page.size(width + 60, height - 100)
        page.until(
            "(({width: w, height: h, clientWidth: W, clientHeight: H}) => w === W && h === H && w === "
            f"{page.run('document.getElementById(`view`).clientWidth')} - 20)(document.getElementById('cut'))"
        )


def test_a_section_that_is_thinned_says_so(browser_page: Driven, small_run: Path) -> None:
    with served(small_run, None, "view.block=1000", "view.together=1000") as server:
        page = opened(browser_page, server)
        page.run(SECTION)
        page.until("fwclass.state.section?.echoes?.length > 20 && fwclass.stats.settled")
        assert "thinned" not in text(page, "cut-says")
        page.run(
            "(() => { const s = fwclass.scenes()[0], all = s.select.bind(s); "
            "s.select = (cam, m, w, h, budget, full) => all(cam, m, w, h, 100, full); fwclass.redraw(); })()"
        )
        page.until("fwclass.stats.settled && !fwclass.state.section.stale")
        assert "thinned" in text(page, "cut-says") and page.faults == []


def test_two_runs_have_one_scale_of_colours_whatever_their_columns(browser_page: Driven, small_run: Path) -> None:
    """One of the runs has a feature that the other has not, and of another values three times as large."""
    other, shared = small_run.parent / "other", "zc"
    shutil.copytree(small_run, other, symlinks=True)
    las = laspy.read(small_run.parent / "a.las")
    las.z = 200 + 3 * (np.asarray(las.z) - 200)
    las.write(small_run.parent / "a.las")
    deliver(small_run.parent, "survey.features=[zc, echo_number, height_range_c200]")
    with served(small_run, other) as server:
        one, two = server.scenes
        own = {f["name"] for f in one.index()["columns"]} - {f["name"] for f in two.index()["columns"]}
        assert own and span_of(one.delivery, shared) != span_of(two.delivery, shared)
        assert one.scale(shared) == two.scale(shared)
        low, high = one.scale(shared)["low"], one.scale(shared)["high"]
        ends = [span_of(s.delivery, shared) for s in (one, two)]
        assert (low, high) == (min(e.low for e in ends), max(e.high for e in ends))
        page, name = opened(browser_page, server), min(own)
        page.run("fwclass.colourBy('zc')")
        page.until("fwclass.stats.settled && fwclass.shown()[1].nodes.every((n) => n.extra)")
        page.run(f"fwclass.colourBy('{name}')")
        page.until("fwclass.stats.settled && fwclass.shown()[0].nodes.every((n) => n.extra)")
        assert page.run("fwclass.shown()[1].nodes.every((n) => !n.extra)")  # not zc under another name
        assert text(page, "legend").rstrip().endswith("has no such column.") and page.faults == []


@pytest.mark.parametrize(("typed", "used"), [("", 2.0), ("-5", 0.2), ("1e9", 100.0), ("7", 7.0)])
def test_the_width_of_a_section_is_what_its_field_shows(
    browser_page: Driven, small_run: Path, typed: str, used: float
) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server)
        page.run(f"document.getElementById('width').value = '{typed}'; {SECTION}")
        page.until("fwclass.state.section && fwclass.stats.settled")
        assert (
            page.run("[2 * fwclass.state.section.half, Number(document.getElementById('width').value)]") == [used] * 2
        )
