"""What the page's tools and keys do and say, in headless Chromium."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pagedriver import Driven, driven
from viewedpage import PICK, PIXELS, SECTION, key, opened, served, text

from fwclass import conf
from fwclass.delivery.viewed_colours import kinds
from fwclass.delivery.viewing import scenes_of
from fwclass.errors import InputError

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def browser_page() -> Iterator[Driven]:
    with driven() as page:
        yield page


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


def test_a_section_leaves_its_line_in_sight_has_the_clouds_colours_and_ends_with_escape(
    browser_page: Driven, small_run: Path
) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server)
        page.run(SECTION)
        page.until("fwclass.state.section?.echoes?.length > 20 && fwclass.stats.settled")
        ends = page.run(
            "(() => { const l = document.querySelector('#marks line').getBoundingClientRect(), top = "
            "document.getElementById('profile').getBoundingClientRect().top; return [l.top, l.bottom, top]; })()"
        )
        assert 0 < ends[0] <= ends[1] < ends[2], ends
        classes = {
            tuple(int(c["colour"][k : k + 2], 16) for k in (1, 3, 5)) for c in server.scenes[0].index()["classes"]
        }
        assert {tuple(map(int, c.split(","))) for c in page.run(PIXELS)} == classes
        echoes = page.run("fwclass.state.section.echoes.length")
        assert sum(page.run(PIXELS).values()) > 4 * echoes  # dots of 3 pixels, some of which hide others
        page.run("fwclass.colourBy('right_or_wrong')")
        page.until(f"fwclass.stats.settled && {PIXELS}['47,125,70']")
        assert set(page.run(PIXELS)) <= {"47,125,70", "200,16,46", "184,190,195"}
        page.run("fwclass.colourBy('height')")
        page.until(f"fwclass.stats.settled && Object.keys({PIXELS}).length > 9")
        key(page, "Escape")
        page.until("fwclass.stats.settled")
        assert page.run("document.getElementById('profile').hidden && !fwclass.state.section")
        assert page.run("document.getElementById('view').clientHeight") == 800 and page.faults == []


def test_sentences_stay_no_longer_than_they_are_true(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server)
        key(page, "r")
        page.until("fwclass.relabel().mode === 'lasso'")
        assert text(page, "count") == "Draw around echoes."
        for name, says, count in (
            ("s", "Click both ends of the section.", ""),
            ("l", "", "Draw around echoes."),
            ("a", "", "Click both ends of a section; then draw a line in it."),
            ("b", "", "Draw over echoes."),
            ("z", "", "Nothing to undo."),
            ("y", "", "Nothing to do again."),
            ("Enter", "", "Nothing is selected: draw first."),
        ):
            key(page, name)
            assert (text(page, "says"), text(page, "count")) == (says, count), name
        key(page, "a")
        page.run("fwclass.click(300, 400); fwclass.click(600, 400)")
        page.until("fwclass.state.section?.echoes?.length > 20")
        assert text(page, "count") == "Draw a line in the section, from one side to the other."
        key(page, "l")
        page.run(
            "(() => { const r = fwclass.relabel(), v = document.getElementById('view'); r.where = 'cloud';"
            "const w = v.clientWidth, h = v.clientHeight; r.stroke = [[0, 0], [w, 0], [w, h], [0, h]]; r.up(); })()"
        )
        page.until("fwclass.relabel().selection")
        key(page, "Enter")
        lines = text(page, "count").splitlines()
        assert lines[0].startswith("6,000 echoes in") and lines[1] == "Choose the class to give, then apply."
        key(page, "Escape")
        assert text(page, "count") == "Draw around echoes."
        key(page, "Escape")
        page.run(
            "Object.assign(fwclass.cam, {tilt: 0.1}); fwclass.moved(); fwclass.tool('section'); fwclass.click(300, 3)"
        )
        assert "sky" in text(page, "says")


def test_a_phone_shows_the_work_list_and_what_a_tap_tells(browser_page: Driven, small_run: Path) -> None:
    with served(small_run, None, "view.unsure=1") as server:
        page = opened(browser_page, server, 390, 844, "&by=confidence")
        low = "document.getElementById('{}').getBoundingClientRect().bottom"
        assert page.run(low.format("next")) <= 844
        assert page.run(PICK)
        page.until("fwclass.stats.why")
        assert page.run(low.format("what")) < 844 - 40 and page.run(low.format("next")) <= 844
        key(page, "p")
        page.until("/ of /.test(document.getElementById('place').textContent)")
        last, _, rest = text(page, "place").partition(" of ")
        assert int(last) > 1 and re.fullmatch(rf"{last}: (1 echo|[23] echoes), \d+ % sure: [a-z]+ \d.*", rest), rest
        page.until("Boolean(document.querySelector('#marks .frame'))")


def test_two_runs_say_which_is_which(browser_page: Driven, small_run: Path) -> None:
    other = small_run.parent.parent / "again" / "run"
    shutil.copytree(small_run, other, symlinks=True)
    with served(small_run, other) as server:
        page = opened(browser_page, server)
        names = ["small: survey/run", "small: again/run"]
        assert page.run("[...document.querySelectorAll('#halves span')].map((e) => e.textContent)") == names
        assert text(page, "name") == " | ".join(names)
        page.run(f"{PICK}")
        page.until("document.getElementById('says').textContent.startsWith('survey/run: ')")
        both = "/ sure; reference: [a-z]+; in again.run [a-z]+, [0-9]+ % sure$/"
        page.until(f"{both}.test(document.getElementById('what').textContent)")
        page.run("fwclass.show(1, fwclass.state.selected)")
        page.until("document.getElementById('says').textContent.startsWith('again/run: ')")
        page.until("document.getElementById('what').textContent.includes('; in survey/run ')")
        page.run(f"{SECTION}; fwclass.colourBy('differs')")
        page.until(f"fwclass.stats.settled && {PIXELS}['127,167,181']")
        key(page, "r")
        assert "not relabelled" in text(page, "says") and page.faults == []


def test_a_place_is_framed_in_the_half_of_its_run(browser_page: Driven, small_run: Path) -> None:
    """On a phone too, where a half is a fifth of a screen."""
    other = small_run.parent.parent / "again" / "run"
    shutil.copytree(small_run, other, symlinks=True)
    with served(small_run, other, "view.unsure=1") as server:
        for width, height in ((390, 844), (1280, 800)):
            page = opened(browser_page, server, width, height)
            for _ in range(3):
                key(page, "n")
                page.until("document.getElementById('place').textContent.startsWith('survey/run: ')")
                page.until("fwclass.stats.settled && Boolean(document.querySelector('#marks .frame'))")
                left, top, right, bottom, wide, high = page.run(
                    "(() => { const r = document.querySelector('#marks .frame').getBoundingClientRect(), v = "
                    "document.getElementById('view'); "
                    "return [r.left, r.top, r.right, r.bottom, v.clientWidth / 2, v.clientHeight]; })()"
                )
                assert min(left, top) >= 0 and right <= wide and bottom <= high
                assert right - left > wide / 5


def test_runs_of_other_places_are_no_pair(small_run: Path, run: Path) -> None:
    with pytest.raises(InputError, match="places that do not meet"):
        scenes_of(small_run, run, conf.section("view", ()))


def test_a_delivery_that_is_gone_is_no_new_one(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server)
        small_run.rename(small_run.with_name("elsewhere"))
        page.size(390, 844)
        page.run("document.getElementById('panel').scrollTop = 1e4")
        page.until("/is gone/.test(document.getElementById('fault').textContent)", 15)
        inside = "(e, p) => e.top >= p.top && e.bottom <= p.bottom"
        boxes = "...['fault', 'panel'].map((i) => document.getElementById(i).getBoundingClientRect())"
        assert page.run(f"({inside})({boxes})")
        assert "button" not in text(page, "fault") and page.run("document.getElementById('take').hidden")
        small_run.with_name("elsewhere").rename(small_run)
        page.until("document.getElementById('fault').hidden", 15)


class OneRun:
    """A run that lasts until it is stopped."""

    running = False

    def state(self) -> dict[str, Any]:
        ended = {"code": None, "lines": [], "why": "", "word": "stopped"}
        return {"allowed": True, "command": "fwclass run", "running": self.running, **ended}

    def start(self) -> dict[str, Any]:
        if self.running:
            raise InputError("the run is under way already")
        self.running = True
        return self.state()

    def stop(self) -> dict[str, Any]:
        self.running = False
        return self.state()


def test_a_run_that_another_page_started_is_seen(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server:
        server.again = one = OneRun()
        page, begins = opened(browser_page, server), "/^Starts/.test(document.getElementById('run-says').textContent)"
        key(page, "r")
        page.until(f"fwclass.relabel().mode === 'lasso' && {begins}")
        one.start()  # from elsewhere
        page.run("document.getElementById('run').click()")
        page.until("!document.getElementById('stop').hidden")
        assert text(page, "run-says") == "The run is under way."
        page.run("document.getElementById('stop').click()")
        page.until(f"document.getElementById('stop').hidden && {begins}")
        assert not one.running
        one.start()
        page.until("!document.getElementById('stop').hidden", 15)  # without a hand
        one.stop()
        page.until(f"document.getElementById('stop').hidden && {begins}", 15)


def test_strips_have_colours_of_their_own(tmp_path: Path) -> None:
    files = [{"strip": n, "path": f"{name}.las"} for n, name in ((7, "c"), (15, "b"), (262, "a"), (1000, "d"))]
    told = kinds("strip", files)
    assert told is not None and [k["name"] for k in told] == ["a.las", "b.las", "c.las", "d.las"]
    assert len({k["colour"] for k in told}) == len({k["code"] for k in told}) == 4
    many = kinds("strip", [{"strip": 3 * n, "path": f"{n}.las"} for n in range(24)])
    assert many is not None and len({k["colour"] for k in many}) == 24


def test_a_name_from_right_to_left_turns_no_number(browser_page: Driven, small_run: Path) -> None:
    """The name of a class as a file may bring it, with a mark that turns what follows."""
    with served(small_run, None, "view.unsure=1") as server:
        page = opened(browser_page, server)
        page.run("for (const c of fwclass.scenes()[0].classes) c.name = 'מבנה\\u202e'")
        assert page.run(PICK)
        page.until("!document.getElementById('picked').hidden")
        seen = """(() => { const node = document.getElementById('what').firstChild, part = (text) => {
            const at = node.textContent.indexOf(text), r = document.createRange();
            r.setStart(node, at); r.setEnd(node, at + text.length); return r.getBoundingClientRect(); };
            return [part('מבנה').right, part(' sure').left, part('%').left]; })()"""
        name, sure, percent = page.run(seen)
        assert name < percent < sure
        key(page, "n")
        page.until("/ of /.test(document.getElementById('place').textContent)")
        assert "\u2068מבנה\u202e\u2069 " in text(page, "place")


def test_a_colour_of_which_no_echo_has_a_value_says_so(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server)
        columns = page.run("fwclass.scenes()[0].columns.map((c) => c.name)")
        assert "width" in columns  # of discrete returns
        page.run("fwclass.colourBy('width')")
        page.until("fwclass.stats.settled")
        assert text(page, "legend").startswith("no echo has a value")
        assert page.run("[...new Set(fwclass.shown()[0].nodes.flatMap((n) => [...n.extra]))]") == [255]
        assert page.faults == []


def test_a_section_that_ends_where_it_begins_waits_for_another_end(browser_page: Driven, small_run: Path) -> None:
    with served(small_run) as server:
        page = opened(browser_page, server)
        page.run("fwclass.tool('section'); for (const x of [300, 300]) fwclass.click(x, 400)")
        assert "elsewhere" in text(page, "says") and page.run("fwclass.state.section") is None
        page.run("fwclass.click(500, 420)")
        page.until("fwclass.state.section && fwclass.stats.settled && !fwclass.state.section.stale")
        assert "m long" in text(page, "cut-says") and page.faults == []
