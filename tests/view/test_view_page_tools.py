"""What the page's tools and keys do and say, in headless Chromium."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from pagedriver import Driven, driven

from fwclass import conf
from fwclass.delivery.viewed_command import LastCommand
from fwclass.delivery.viewing import scenes_of
from fwclass.view.server import Server

pytestmark = pytest.mark.slow

PICK = """(() => { const v = document.getElementById('view'), w = v.clientWidth, h = v.clientHeight;
for (let k = 0; k < 80; k += 1)
if (fwclass.click(w * (0.3 + 0.4 * ((k * 7) % 13) / 13), h * (0.35 + 0.3 * ((k * 5) % 11) / 11))) return true;
return false; })()"""
"""A click that finds an echo."""


@pytest.fixture(scope="module")
def browser_page() -> Iterator[Driven]:
    with driven() as page:
        yield page


@contextmanager
def served(root: Path, against: Path | None = None, allowed: bool = False) -> Iterator[Server]:
    params = conf.section("view", ())
    again = LastCommand(root, allowed)
    with Server(scenes_of(root, against, params), params, again=again) as server, closing(again):
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


def opened(page: Driven, server: Server, width: int = 1280, height: int = 800, more: str = "") -> Driven:
    page.open("about:blank")
    page.run("1")  # what the page before still asked for is over
    page.requests.clear()
    page.faults.clear()
    page.size(width, height)
    page.open(server.address + more)
    page.until("window.fwclass.stats.settled")
    page.run("sessionStorage.clear()")
    return page


def key(page: Driven, name: str) -> None:
    for kind in ("keyDown", "keyUp"):
        page.ask("Input.dispatchKeyEvent", type=kind, key=name)


def text(page: Driven, name: str) -> str:
    return str(page.run(f"document.getElementById('{name}').innerText"))


SEEN = """(() => { const gl = document.getElementById('view').getContext('webgl2'), w = gl.drawingBufferWidth,
h = gl.drawingBufferHeight, px = new Uint8Array(4 * w * h), out = {};
gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, px);
for (let k = 0; k < px.length; k += 4) { const c = px.slice(k, k + 3).join(); out[c] = (out[c] || 0) + 1; }
return out; })()"""
"""How many pixels have which colour."""


def test_the_tool_of_relabelling_leaves_kinds_their_colours(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server)
        page.run("fwclass.colourBy('right_or_wrong')")
        page.until("fwclass.stats.settled")
        before = page.run(SEEN)
        key(page, "r")
        page.until("fwclass.relabel().mode === 'lasso' && fwclass.stats.settled")
        after = page.run(SEEN)
        right, white = "47,125,70", "255,255,255"
        assert before[right] > 1000 and after[right] > 0.9 * before[right]
        assert after.get(white, 0) <= before.get(white, 0)


def test_a_letter_takes_its_tool_and_never_leaves_it(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server)
        key(page, "r")
        key(page, "b")  # while the tool opens
        page.until("fwclass.relabel().may")
        mode = "fwclass.relabel().mode"
        assert page.run(mode) == "brush"
        for letter, tool in (("l", "lasso"), ("l", "lasso"), ("b", "brush"), ("Escape", "")):
            key(page, letter)
            assert page.run(mode) == tool
        for tool in ("lasso", ""):  # who has no keys leaves it by its button
            page.run("document.getElementById('lasso').click()")
            assert page.run(mode) == tool
        key(page, "r")
        key(page, "r")
        key(page, "r")
        page.run("new Promise((done) => setTimeout(done, 500))")
        assert page.run("fwclass.relabel().open") is False and page.run(mode) == ""


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
def test_the_whole_survey_is_seen(browser_page: Driven, small_run: Path, width: int, height: int) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server, width, height)
        ends = """(async () => { const { matrix, project } = await import('./camera.js'),
            { placeOf } = await import('./scene.js'); const v = document.getElementById('view');
            const w = v.clientWidth, h = v.clientHeight, m = matrix(fwclass.cam, w / h); let e = [9, 9, -9, -9];
            for (const n of fwclass.shown()[0].nodes) for (let k = 0; k < n.count; k += 1) {
              const [x, y] = project(m, placeOf(n, k), w, h);
              e = [Math.min(e[0], x / w), Math.min(e[1], y / h), Math.max(e[2], x / w), Math.max(e[3], y / h)]; }
            return e; })()"""
        first = page.run(ends)
        page.run("Object.assign(fwclass.cam, {far: 7, tilt: 0.2}); fwclass.moved()")
        key(page, "0")
        assert page.run(ends) == pytest.approx(first)
        assert min(first[:2]) > 0 and max(first[2:]) < 1, first
        assert max(first[2] - first[0], first[3] - first[1]) > 0.8, first  # no smaller than need be


def test_of_discrete_returns_no_waveform_is_asked_for(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server)
        assert page.run(PICK)
        page.until("fwclass.stats.why")
        assert text(page, "wave-says") == "This survey has no waveforms."
        assert page.run("document.getElementById('wave').getBoundingClientRect().height") == 0
        assert page.faults == [] and not [r for r in page.requests if "/pulse/" in r]


def test_a_fault_is_told_in_lines(browser_page: Driven, small_run: Path) -> None:
    (small_run / "labels").write_text("")  # in the way
    with served(small_run) as server:
        page = opened(browser_page, server)
        key(page, "r")
        page.until("document.getElementById('relabel-says').textContent")
        lines = text(page, "relabel-says").splitlines()
        assert lines[0] == "corrections cannot be written here"
        assert [line.split(":")[0] for line in lines[1:]] == ["where", "expected", "got", "what to do"]
