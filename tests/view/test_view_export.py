"""A run's page in a folder: its files against the run, and the page in headless Chromium from a plain web server."""

from __future__ import annotations

import json
import re
import struct
import threading
import zlib
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from commandline import fwclass
from drawn import box, drawn, drawn_classes, marked
from pagedriver import Driven, driven
from smallsurvey import deliver, small_survey

from fwclass import conf
from fwclass.delivery.exported import export_view
from fwclass.delivery.opened import open_run
from fwclass.delivery.viewed import ViewedRun
from fwclass.errors import ConfigError
from fwclass.publish.files import whole_directory
from fwclass.schema import IDENTITY
from fwclass.view.selection import Selection

SMALL = ("view.block=2000", "view.together=6000", "view.export=3")
"""Blocks of every kind: levels of several tiles, levels that are sent whole, nodes alone."""


@pytest.fixture(scope="module")
def folder(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("exported") / "site"
    ended = fwclass("view", run, "--export", path, *(w for s in SMALL for w in ("--set", s)))
    assert ended.returncode == 0 and str(path) in ended.stderr, ended.stderr
    return path


@pytest.fixture(scope="module")
def shown(run: Path) -> ViewedRun:
    return ViewedRun(open_run(run), conf.section("view", SMALL))


class Served(ThreadingHTTPServer):
    """`python -m http.server`, which remembers what it refused."""

    def __init__(self, directory: Path) -> None:
        self.refused: list[str] = []
        super().__init__(("127.0.0.1", 0), partial(_Handler, directory=str(directory)))

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/site/"


class _Handler(SimpleHTTPRequestHandler):
    server: Served

    def log_request(self, code: object = "-", size: object = "-") -> None:
        if int(code) >= 400:  # type: ignore[call-overload]
            self.server.refused.append(self.path)

    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture(scope="module")
def served(folder: Path) -> Iterator[Served]:
    with Served(folder.parent) as server:
        threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
        yield server
        server.shutdown()


@pytest.fixture(scope="module")
def browser_page() -> Iterator[Driven]:
    with driven() as page:
        yield page


@pytest.fixture
def page(browser_page: Driven, served: Served) -> Driven:
    browser_page.requests.clear()
    browser_page.faults.clear()
    served.refused.clear()
    browser_page.size(1280)
    browser_page.open(served.address)
    browser_page.until("window.fwclass.stats.settled")
    return browser_page


def told(folder: Path) -> dict:
    return json.loads((folder / "data/0/index.json").read_text())["folder"]


def test_every_block_is_what_the_server_answers(folder: Path, shown: ViewedRun) -> None:
    index = shown.index()
    about, levels, nodes = told(folder), 0, set()
    assert about["columns"][:1] == ["strip"] and {"entropy", "right_or_wrong"} <= set(about["columns"])
    for part in ("echoes", *about["columns"]):
        for path in (folder / "data/0" / part).glob("*.bin"):
            if path.stem.startswith("level-"):
                assert path.read_bytes() == shown.level(part, int(path.stem[6:])), path
                levels += part == "echoes"
            else:
                assert path.read_bytes() == shown.node(part, tuple(map(int, path.stem.split("-")))), path
                nodes |= {path.stem} if part == "echoes" else set()
    assert levels == len(index["together"]) > 2 and set(about["nodes"]) == nodes and len(nodes) > 5
    assert max(index["together"]) < shown.pyramid.last and shown.pyramid.own > 0
    assert echoes_in(folder) == shown.echoes
    assert json.loads((folder / "data/0/strip/scale.json").read_text())["classes"][0]["name"] == "strip_01.las"


def echoes_in(folder: Path) -> int:
    """Of all blocks."""
    echoes = 0
    for path in (folder / "data/0/echoes").glob("*.bin"):
        data, at = path.read_bytes(), 0
        while at < len(data):
            echoes += struct.unpack_from("<I", data, at + 16)[0]
            at += 64 + struct.unpack_from("<I", data, at)[0]
    return echoes


@pytest.mark.slow
@pytest.mark.parametrize(("size", "stray"), [(1000, None), (25, (500.0, 0.0))], ids=["one tile", "a tile of one echo"])
def test_a_run_without_coarse_levels_and_a_tile_of_one_echo(
    tmp_path: Path, size: int, stray: tuple[float, float] | None
) -> None:
    small_survey(tmp_path, stray)
    deliver(tmp_path, f"tile.size={size}")
    params = conf.section("view", ("view.unsure=0.9", "view.together=1000", "view.block=1000"))
    export_view(tmp_path / "run", None, params, tmp_path / "site", print)
    tiles = open_run(tmp_path / "run").tiles
    assert len(tiles) == 1 if stray is None else min(t["echoes"] for t in tiles) == 1
    assert echoes_in(tmp_path / "site") == 6000 + (stray is not None)
    scene = ViewedRun(open_run(tmp_path / "run"), params)
    assert sum(map(len, drawn_classes(scene).values())) == scene.echoes
    told = scene.relabel.select(Selection.of(drawn(box(500_000, 5_400_000, 501_000, 5_400_100))))
    assert told["echoes"] == scene.echoes
    marks = marked(scene.relabel.marks(told["selection"]))
    assert sum(map(len, marks.values())) == scene.echoes
    assert json.loads((tmp_path / "site/data/0/work.json").read_text())["places"]


def test_every_node_says_who_its_echoes_are(folder: Path, shown: ViewedRun) -> None:
    """Read here by another program than the page, against the delivered table."""
    seen = 0
    for path in sorted((folder / "data/0/identity").glob("*.bin"))[::7]:
        data, node = path.read_bytes(), tuple(map(int, path.stem.split("-")))
        count = struct.unpack_from("<I", data, 16)[0]
        planes = np.frombuffer(zlib.decompress(data[64:]), np.uint8).reshape(7, count).astype(np.int64)
        strip, pulse = planes[0] + 256 * planes[1], (planes[2:6].T * 256 ** np.arange(4)).sum(axis=1)
        for row in {0, count // 2, count - 1}:
            values = shown.echo(node, row)["values"]
            assert [strip[row], pulse[row], planes[6][row]] == [values[n] for n in IDENTITY]
            seen += 1
    assert seen > 10


def test_the_least_sure_echoes_of_every_place_are_there_whole(folder: Path, shown: ViewedRun) -> None:
    work = json.loads((folder / "data/0/work.json").read_text())
    plain = shown.work()
    assert [{k: v for k, v in p.items() if k != "told"} for p in work["places"]] == json.loads(
        json.dumps(plain["places"])
    )
    table = shown.delivery.echoes().to_pandas()
    table = table[table.confidence < work["unsure"]]
    table["place"] = shown.work_list().of(table.x.to_numpy(), table.y.to_numpy())
    least = table.sort_values(["place", "confidence", *IDENTITY]).groupby("place").head(3)
    names = [f"{r.strip}-{r.pulse}-{r.echo_number}" for r in least[least.place >= 0].itertuples()]
    assert [t["echo"] for p in work["places"] for t in p["told"]] == names == told(folder)["told"]
    for one in [t for p in work["places"][:4] for t in p["told"]]:
        node, (strip, pulse, number) = tuple(one["node"]), map(int, one["echo"].split("-"))
        here = folder / "data/0"
        about = json.loads((here / f"echo/{'-'.join(map(str, node))}/{one['row']}.json").read_text())
        served = shown.echo(node, one["row"])
        assert about == {k: served[k] for k in about} and about["values"]["pulse"] == pulse
        assert one["place"] == pytest.approx([about["values"][a] - o for a, o in zip("xyz", shown.origin, strict=True)])
        assert json.loads((here / f"pulse/{strip}-{pulse}.json").read_text()) == shown.pulse(strip, pulse)
        why = json.loads((here / f"why/{strip}-{pulse}-{number}.json").read_text())
        assert why["shares"] == pytest.approx(shown.delivery.explain((strip, pulse, number)).shares)


def test_the_page_draws_and_asks_for_nothing_that_is_not_there(page: Driven, served: Served, shown: ViewedRun) -> None:
    assert page.run("fwclass.stats.drawn") == shown.echoes
    for name in ("entropy", "strip", "right_or_wrong", "height"):
        page.run(f"fwclass.colourBy('{name}')")
        page.until("fwclass.stats.settled")
    listed = page.run("[...document.getElementById('by').options].map((o) => o.value)")
    assert "entropy" in listed and "echo_ratio_r100" not in listed
    assert served.refused == [] and page.faults == []
    assert all(r.startswith((served.address, "about:")) for r in page.requests), page.requests


@pytest.mark.slow
def test_a_place_of_the_work_list_shows_its_waveform(page: Driven, served: Served, folder: Path) -> None:
    work = json.loads((folder / "data/0/work.json").read_text())["places"]
    for k in (0, 1):
        page.run("fwclass.stats.wave = fwclass.stats.why = null; fwclass.step(1)")
        page.until("fwclass.stats.wave && fwclass.stats.why")
        name = work[k]["told"][0]["echo"]
        assert page.run("[fwclass.stats.wave.strip, fwclass.stats.wave.pulse]") == [int(v) for v in name.split("-")[:2]]
        assert not page.run("document.getElementById('wave').hidden")
        assert page.run("document.querySelectorAll('#values tr').length") > 20
    page.until("fwclass.stats.settled && document.querySelectorAll('#marks circle').length === 4")
    page.run("fwclass.stats.wave = null")
    circle = "document.querySelectorAll('#marks circle')[1]"
    other = page.run(f"[{circle}.cx.baseVal.value, {circle}.cy.baseVal.value]")
    page.run(f"Boolean(fwclass.click({other[0]}, {other[1]}))")
    page.until("fwclass.stats.wave")
    assert served.refused == [] and page.faults == []


def test_any_echo_says_who_it_is(page: Driven, served: Served, folder: Path, shown: ViewedRun) -> None:
    asked, known = 0, set(told(folder)["told"])
    for k in range(40):
        x, y = 300 + 11 * k, 300 + 37 * k % 200
        hit = page.run(f"(() => {{ const h = fwclass.click({x}, {y}); return h && [h.node.node, h.row]; }})()")
        if not hit:
            continue
        values = shown.echo(tuple(hit[0]), hit[1])["values"]
        if "-".join(str(values[n]) for n in IDENTITY) in known:
            continue
        who = "strip {strip}, pulse {pulse}, echo {echo_number}".format(**values)
        page.until(f"document.getElementById('says').textContent.endsWith('{who}')")
        assert "circled" in page.run("document.getElementById('wave-says').textContent")
        shares = page.run("document.getElementById('what').textContent")
        assert re.search(rf"{round(100 * values['confidence'])} % sure", shares)
        asked += 1
    assert asked >= 5 and served.refused == [] and page.faults == []


def test_a_policy_stands_in_the_page_and_a_file_says_what_it_needs(browser_page: Driven, folder: Path) -> None:
    text = (folder / "index.html").read_text()
    assert "default-src &#x27;none&#x27;" in text and "frame-ancestors" not in text
    for width in (390, 1280):
        browser_page.size(width)
        browser_page.open((folder / "index.html").as_uri())
        browser_page.until("document.getElementById('unserved').getBoundingClientRect().width > 200")
        words = "getComputedStyle(document.getElementById('unserved')).visibility === 'visible'"
        browser_page.until(words)
        assert browser_page.run("getComputedStyle(document.getElementById('panel')).visibility") == "hidden"
        assert browser_page.run("document.documentElement.scrollWidth") <= width


@pytest.mark.slow
def test_a_survey_without_waveforms_says_so(tmp_path: Path) -> None:
    survey = small_survey(tmp_path)
    assert fwclass("run", survey, "--out", tmp_path / "run", "--workers", 0).returncode == 0
    ended = fwclass(
        "view", tmp_path / "run", "--export", tmp_path / "site", "--set", "view.unsure=1", "--set", "view.export=1"
    )
    assert ended.returncode == 0, ended.stderr
    assert "waveform of" not in ended.stderr and not list((tmp_path / "site/data/0/pulse").iterdir())
    index = json.loads((tmp_path / "site/data/0/index.json").read_text())
    assert index["waveforms"] == {"strips": [], "lost": [], "says": "This survey has no waveforms."}
    assert str(tmp_path) not in "".join(p.read_text() for p in (tmp_path / "site").rglob("*.json"))


@pytest.mark.slow
def test_two_runs_side_by_side(run: Path, tmp_path: Path, browser_page: Driven) -> None:
    ended = fwclass("view", run, "--against", run, "--export", tmp_path / "site", "--set", "view.export=0")
    assert ended.returncode == 0, ended.stderr
    with Served(tmp_path) as server:
        threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
        browser_page.size(1280)
        browser_page.faults.clear()
        browser_page.open(server.address)
        browser_page.until("window.fwclass.stats.settled")
        browser_page.run("fwclass.colourBy('differs')")
        browser_page.until("fwclass.stats.settled")
        seen = "[...new Set(fwclass.shown().flatMap((v) => v.nodes.flatMap((n) => [...n.extra])))]"
        assert browser_page.run(seen) == [1]
        assert browser_page.faults == [] and server.refused == []
        server.shutdown()


def test_a_folder_is_written_whole_or_not_at_all(run: Path, folder: Path, tmp_path: Path) -> None:
    before = sorted(p.name for p in folder.iterdir())
    ended = fwclass("view", run, "--export", folder)
    assert ended.returncode == 2 and "a directory of its own" in ended.stderr
    assert sorted(p.name for p in folder.iterdir()) == before
    for words in (("--port", 1), ("--no-browser",), ("--overwrite",), ("--worklist", tmp_path / "a.gpkg")):
        assert fwclass("view", run, "--export", tmp_path / "new", *words).returncode == 2
    ended = fwclass("view", tmp_path / "none", "--export", tmp_path / "new")
    assert ended.returncode == 1 and "no such run" in ended.stderr
    with pytest.raises(KeyError), whole_directory(tmp_path / "new") as beside:
        (beside / "half").write_text("")
        raise KeyError
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError), whole_directory(tmp_path / "file"):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
