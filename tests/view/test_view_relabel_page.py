"""Relabelling in headless Chromium: by mouse, keys and touch, in the cloud and in a section; run again; two windows."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
from pagedriver import Driven, driven, running
from smallsurvey import deliver

from fwclass import conf
from fwclass.delivery.opened import open_run
from fwclass.delivery.viewed import ViewedRun
from fwclass.delivery.viewed_command import LastCommand
from fwclass.store.corrections import CORRECTIONS, read_corrections
from fwclass.view.server import Server

pytestmark = pytest.mark.slow

COUNT = "document.getElementById('count').textContent"
SELECTED = "fwclass.relabel().selection && !fwclass.relabel().busy"
MARKED = "fwclass.shown()[0].nodes.reduce((s, n) => s + (n.marks ? n.marks.reduce((a, b) => a + b, 0) : 0), 0)"
CODES = """(() => { const out = {};
for (const n of fwclass.shown()[0].nodes) for (let k = 0; k < n.count; k += 1) {
const c = n.bytes[12 * k + 10]; out[c] = (out[c] || 0) + 1; } return out; })()"""
FROM_ABOVE = "Object.assign(fwclass.cam, {tilt: 1.5707, azimuth: 0}); fwclass.moved()"
SMALL_BLOCKS = ("view.block=1000", "view.together=1000")


@pytest.fixture(scope="module")
def browser_page() -> Iterator[Driven]:
    with driven() as page:
        yield page


@contextmanager
def served(root: Path, allowed: bool = False) -> Iterator[Server]:
    params = conf.section("view", SMALL_BLOCKS)
    again = LastCommand(root, allowed)
    with closing(again), running(Server([ViewedRun(open_run(root), params)], params, again=again)) as server:
        yield server


def opened(page: Driven, server: Server, width: int = 1280) -> Driven:
    """The page with the tool open, seen from above."""
    page.open("about:blank")
    page.run("1")  # what the page before still asked for is over
    page.requests.clear()
    page.faults.clear()
    page.size(width)
    page.open(server.address)
    page.until("window.fwclass.stats.settled")
    page.run(f"sessionStorage.clear(); {FROM_ABOVE}; fwclass.edit()")
    page.until("fwclass.relabel().mode === 'lasso' && fwclass.stats.settled")
    return page


def hand(page: Driven, places: list[tuple[float, float]]) -> None:
    """A stroke of the mouse."""
    for k, (x, y) in enumerate([*places, places[-1]]):
        kind = "mousePressed" if k == 0 else "mouseReleased" if k == len(places) else "mouseMoved"
        page.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)


def circle(page: Driven, part: float = 0.2) -> list[tuple[float, float]]:
    """Around the middle of the cloud's view."""
    w, h = page.run("[document.getElementById('view').clientWidth, document.getElementById('view').clientHeight]")
    r, turns = part * min(w, h), [2 * math.pi * k / 24 for k in range(24)]
    return [(w / 2 + r * math.cos(t), h / 2 + r * math.sin(t)) for t in turns]


def refused(page: Driven) -> list[str]:
    """Faults but the browser's own note that an answer was refused because the run had delivered."""
    return [f for f in page.faults if "409" not in f]


def key(page: Driven, name: str) -> None:
    for kind in ("keyDown", "keyUp"):
        page.ask("Input.dispatchKeyEvent", type=kind, key=name)


def inside(page: Driven, places: list[tuple[float, float]]) -> int:
    """Echoes on the screen that the page itself projects into the polygon."""
    return int(
        page.run(
            f"""(async () => {{ const c = {[list(p) for p in places]};
            const {{ matrix, project }} = await import('./camera.js'), {{ placeOf }} = await import('./scene.js');
            const v = document.getElementById('view'), w = v.clientWidth, h = v.clientHeight;
            const m = matrix(fwclass.cam, w / h); let sum = 0;
            for (const n of fwclass.shown()[0].nodes) for (let k = 0; k < n.count; k += 1) {{
              const [x, y] = project(m, placeOf(n, k), w, h); let odd = false;
              c.forEach(([a, b], i) => {{ const [p, q] = c[(i + 1) % c.length];
                if ((b > y) !== (q > y) && x < a + (y - b) * (p - a) / (q - b)) odd = !odd; }});
              sum += odd; }} return sum; }})()"""
        )
    )


def test_what_is_drawn_around_is_counted_marked_written_and_undone(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server)
        before = page.run(CODES)
        hand(page, circle(page))
        page.until(SELECTED)
        told = page.run("fwclass.relabel().selection")
        assert told["echoes"] > 300 and page.run(COUNT).startswith(f"{told['echoes']:,} echoes in {told['tiles']} tile")
        assert page.run(MARKED) == told["echoes"]
        assert abs(inside(page, circle(page)) - told["echoes"]) <= 5  # the page's places are rounded
        assert not (small_run / CORRECTIONS).exists()

        key(page, "Enter")  # no class is chosen yet
        assert page.run("document.getElementById('apply').disabled") and not (small_run / CORRECTIONS).exists()
        page.run("document.getElementById('give').value = '5'; document.getElementById('give').onchange()")
        assert not page.run("document.getElementById('apply').disabled")
        key(page, "Enter")
        page.until(f"/Written/.test({COUNT})")
        rows = read_corrections(small_run)
        ground = told["classes"]["2"]
        assert set(rows.code) == {5} and rows.rows == ground + told["classes"].get("5", 0)
        page.until("fwclass.stats.settled")
        after = page.run(CODES)
        assert after["2"] == before["2"] - ground and after["5"] == before["5"] + ground
        assert page.run(MARKED) == 0

        page.open(server.address)
        page.until("window.fwclass && fwclass.stats.settled")
        assert page.run(CODES) == after  # as written, after a reload
        page.run("fwclass.edit()")
        page.until("fwclass.relabel().mode === 'lasso'")
        key(page, "z")
        page.until(f"/Undone/.test({COUNT})")
        assert page.run(CODES) == before and (read_corrections(small_run).standing().code == -1).all()
        key(page, "y")
        page.until(f"/Done again/.test({COUNT})")
        assert page.run(CODES) == after
        assert page.faults == [] and all(r.startswith((server.address.split("#")[0], "about:")) for r in page.requests)


def test_a_click_on_a_corrected_echo_tells_both_classes(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server)
        hand(page, circle(page))
        page.until(SELECTED)
        page.run("document.getElementById('give').value = '0'; fwclass.relabel().apply()")
        page.until(f"/no class/.test({COUNT})")
        page.run("fwclass.relabel().use(''); fwclass.colourBy('corrected')")
        page.until("fwclass.stats.settled")
        kinds = page.run("[...new Set(fwclass.shown()[0].nodes.flatMap((n) => [...n.extra]))].sort()")
        assert kinds == [0, 2]
        for x, y in circle(page, 0.1):
            page.click(x, y)
        page.until("/corrected: no class/.test(document.getElementById('what').textContent)")


def test_above_a_line_in_a_section(browser_page: Driven, small_run: Path) -> None:
    """What is above the line in metres, computed here from the delivery, is what is selected."""
    with served(small_run) as server:
        page = opened(browser_page, server)
        xs = [p[0] for p in circle(page, 0.3)]
        y = circle(page)[0][1]
        key(page, "a")  # without a section it asks for one first
        page.click(min(xs), y)
        page.click(max(xs), y)
        page.until("fwclass.state.section?.echoes?.length > 20")
        page.run("document.getElementById('exaggeration').value = 3; fwclass.redraw()")
        page.until("fwclass.stats.settled && fwclass.state.section.view.over === 3")
        left, top, width, height = page.run(
            "(() => { const r = document.getElementById('cut').getBoundingClientRect();"
            "return [r.left, r.top, r.width, r.height]; })()"
        )
        from_, to = (left + 0.3 * width, top + 0.6 * height), (left + 0.7 * width, top + 0.5 * height)
        hand(page, [to, ((from_[0] + to[0]) / 2, (from_[1] + to[1]) / 2), from_])
        page.until(SELECTED)
        told = page.run("fwclass.relabel().selection")
        line = page.run("(({A, B, half, view}) => ({A, B, half, view}))(fwclass.state.section)")
        scene = server.scenes[0]
        parts = [scene.open.columns(t, ("x", "y", "z")) for t in scene.tiles]
        at = np.stack([np.concatenate([p[a] for p in parts]) for a in "xyz"], axis=1) - scene.origin
        a, b = np.array(line["A"]), np.array(line["B"])
        u = (b - a)[:2] / np.hypot(*(b - a)[:2])
        s, t = (at - a)[:, :2] @ u, (at - a)[:, :2] @ [u[1], -u[0]]
        v = line["view"]
        px, py = v["left"] + s * v["k"], v["bottom"] - (at[:, 2] - v["low"]) * v["k"] * v["over"]
        rise = (to[1] - from_[1]) / (to[0] - from_[0])
        over = py + top < from_[1] + (px + left - from_[0]) * rise
        within = (px + left > from_[0]) & (px + left < to[0]) & (abs(t) <= line["half"]) & over
        assert within.sum() > 10 and abs(int(within.sum()) - told["echoes"]) <= 2
        assert page.run("fwclass.relabel().along") and page.run(MARKED) == told["echoes"]
        key(page, "Escape")
        assert page.run(MARKED) == 0 and page.faults == []


def test_filters_and_classes_that_are_off_leave_echoes_out(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server)
        hand(page, circle(page))
        page.until(SELECTED)
        every = page.run("fwclass.relabel().selection")
        page.run("document.querySelector('#classes input').click()")
        page.until(f"({SELECTED}) && !fwclass.relabel().selection.classes[2]")
        assert page.run("fwclass.relabel().selection.echoes") == every["classes"]["5"]
        page.run("const e = document.getElementById('lowest'); e.value = 3; e.onchange()")
        page.until(f"({SELECTED}) && fwclass.relabel().selection.echoes < {every['classes']['5']}")
        page.run("const f = document.getElementById('highest'); f.value = 1; f.onchange()")
        page.until(f"/wrong way round/.test({COUNT})")
        assert page.run("document.getElementById('apply').disabled")


def test_a_brush_and_fingers(browser_page: Driven, small_run: Path) -> None:
    """One finger draws, a second one ends the stroke and moves the view."""
    with served(small_run) as server:
        page = opened(browser_page, server, 390)
        key(page, "b")
        (x, y), *_ = circle(page, 0.1)
        touch = [{"x": x, "y": y, "id": 0}]
        page.ask("Input.dispatchTouchEvent", type="touchStart", touchPoints=touch)
        for k in range(1, 6):
            page.ask("Input.dispatchTouchEvent", type="touchMove", touchPoints=[{"x": x - 8 * k, "y": y, "id": 0}])
        page.ask("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        page.until(SELECTED)
        first = page.run("fwclass.relabel().selection.echoes")
        assert first > 10
        far = page.run("fwclass.cam.far")
        page.ask("Input.dispatchTouchEvent", type="touchStart", touchPoints=touch)
        both = [{"x": x - 20, "y": y, "id": 0}, {"x": x + 40, "y": y, "id": 1}]
        page.ask("Input.dispatchTouchEvent", type="touchStart", touchPoints=[touch[0], both[1]])
        page.ask("Input.dispatchTouchEvent", type="touchMove", touchPoints=both)
        page.ask("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        assert page.run("fwclass.cam.far") < far and page.run("fwclass.relabel().stroke.length") == 0
        assert page.run("fwclass.relabel().selection.echoes") == first
        assert page.faults == []


def test_two_windows_see_each_others_corrections(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server, driven() as other:
        page = opened(browser_page, server)
        opened(other, server)
        hand(page, circle(page))
        page.until(SELECTED)
        page.run("document.getElementById('give').value = '5'; fwclass.relabel().apply()")
        page.until(f"/Written/.test({COUNT})")
        after = page.run(CODES)
        other.until(f"JSON.stringify({CODES}) === '{page.run(f'JSON.stringify({CODES})')}'", 15)
        hand(other, circle(other, 0.1))
        other.until(SELECTED)
        other.run("document.getElementById('give').value = '2'; fwclass.relabel().apply()")
        other.until(f"/Written/.test({COUNT})")
        page.until(f"{CODES}['2'] > {after['2']}", 15)
        key(page, "z")
        page.until(f"/have another class by now and stay/.test({COUNT})")
        assert set(read_corrections(small_run).standing().code) == {-1, 2}
        assert page.faults == [] and other.faults == []


def test_where_nothing_can_be_written_the_tool_says_so_and_stays_shut(browser_page: Driven, small_run: Path) -> None:
    (small_run / "labels").write_text("")  # in the way: also root cannot write below it
    with served(small_run) as server:
        page = browser_page
        page.open(server.address)
        page.until("window.fwclass && fwclass.stats.settled")
        page.run("fwclass.edit()")
        page.until("/cannot be written here/.test(document.getElementById('relabel-says').textContent)")
        assert page.run("document.getElementById('lasso').disabled && document.getElementById('apply').disabled")
        azimuth = page.run("fwclass.cam.azimuth")
        page.drag(300, 300, 60, 0)
        assert page.run("fwclass.cam.azimuth") != azimuth  # the hand still turns the view


def test_a_run_is_started_watched_and_its_classes_are_seen(browser_page: Driven, small_run: Path) -> None:
    """Relabel, run, reload: bushes that were called ground are delivered as ground."""
    with served(small_run, allowed=True) as server:
        page = opened(browser_page, server)
        before = server.scenes[0]
        page.run("document.querySelector('#classes input').click(); document.getElementById('highest').value = 3")
        hand(page, circle(page))
        page.until(SELECTED)
        page.run("document.getElementById('give').value = '2'; fwclass.relabel().apply()")
        page.until(f"/Written/.test({COUNT})")
        assert page.run("document.getElementById('command').textContent").startswith("fwclass run ")
        page.run("window.before = true; document.getElementById('run').click()")
        page.until("!window.before || document.querySelectorAll('#lines div').length > 2", 300)
        page.until("!window.before && fwclass.stats.settled", 300)
        page.until("/ended: done/.test(document.getElementById('run-says').textContent)")
        assert server.scenes[0] is not before and page.run("fwclass.relabel().open")
        page.run("fwclass.colourBy('corrected')")
        page.until("fwclass.stats.settled")
        kinds = page.run("fwclass.shown()[0].nodes.flatMap((n) => [...n.extra])")
        assert kinds.count(1) > kinds.count(2) and kinds.count(1) > 50
        assert refused(page) == []


def test_a_new_delivery_under_an_open_page_is_told_and_taken(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server)
        assert page.run("document.getElementById('run').hidden")
        assert "--allow-run" in page.run("document.getElementById('run-says').textContent")
        hand(page, circle(page))
        page.until(SELECTED)
        page.run("document.getElementById('give').value = '2'; fwclass.relabel().apply()")
        page.until(f"/Written/.test({COUNT})")
        deliver(small_run.parent)
        page.until("/delivered anew/.test(document.getElementById('fault').textContent)", 15)
        page.run("window.before = true; document.getElementById('take').click()")
        page.until("!window.before && fwclass.stats.settled && document.getElementById('fault').hidden")
        assert refused(page) == []


@pytest.mark.parametrize("width", [390, 1280])
def test_the_tool_lies_inside_the_window(browser_page: Driven, small_run: Path, width: int) -> None:
    import matplotlib.image

    with served(small_run, allowed=True) as server:
        page = opened(browser_page, server, width)
        page.run("document.querySelector('#relabelling details').open = true")
        hand(page, circle(page))
        page.until(SELECTED)
        page.until("fwclass.stats.settled")
        page.run("new Promise((done) => setTimeout(done, 600))")
        inside = (
            "[...document.querySelectorAll('#panel *')].every((e) => e.getBoundingClientRect().right <= innerWidth)"
        )
        assert page.run("document.documentElement.scrollWidth") <= width and page.run(inside)
        shown = (matplotlib.image.imread(io.BytesIO(page.picture()))[:, :, :3] * 255).astype(int)
        red, green, blue = (shown[:, :, k] for k in range(3))
        assert ((red - green > 60) & (blue - green > 40)).sum() > 200  # the selected echoes
