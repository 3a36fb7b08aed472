"""The page in headless Chromium: what it draws, asks for, picks and tells."""

from __future__ import annotations

import io
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pagedriver import Driven, driven
from scipy.spatial import cKDTree
from smallsurvey import deliver

from fwclass import conf
from fwclass.delivery.opened import Delivery, open_run
from fwclass.delivery.viewed import ViewedRun
from fwclass.delivery.viewed_pair import same_echo
from fwclass.delivery.viewing import scenes_of
from fwclass.graph.training_rows import survey_sample
from fwclass.run.inputs import PartInputs
from fwclass.schema import IDENTITY
from fwclass.store.models import load_model
from fwclass.store.run_store import Store
from fwclass.view.server import Server


@pytest.fixture(scope="module")
def browser_page() -> Iterator[Driven]:
    with driven() as page:
        yield page


@pytest.fixture
def page(browser_page: Driven, server: Server) -> Driven:
    browser_page.requests.clear()
    browser_page.faults.clear()
    browser_page.size(1280)
    browser_page.open(server.address)
    browser_page.until("window.fwclass.stats.settled")
    return browser_page


PLACES = """(() => {
  const view = document.getElementById('view'), out = [];
  for (let k = 0; k < 40; k += 1)
    out.push([view.clientWidth * (0.3 + 0.4 * ((k * 7) % 13) / 13),
      view.clientHeight * (0.35 + 0.3 * ((k * 5) % 11) / 11)]);
  return out;
})()"""


def test_it_draws_all_echoes_and_asks_nobody_else(page: Driven, server: Server, scene: ViewedRun) -> None:
    assert page.run("fwclass.stats.drawn") == scene.echoes
    assert page.run("fwclass.traffic.requests") < 100  # of the small blocks that these tests have
    assert all(r.startswith((server.address.split("#")[0], "about:")) for r in page.requests), page.requests
    assert page.faults == []


def test_classes_have_their_colours_where_they_lie(page: Driven, scene: ViewedRun) -> None:
    """Pixels of a picture from above, against the echoes projected here."""
    import matplotlib.image

    page.run("Object.assign(fwclass.cam, {tilt: 1.5707, azimuth: 0}); fwclass.moved()")
    page.until("fwclass.stats.settled")
    page.run("new Promise((done) => setTimeout(done, 600))")
    image = (matplotlib.image.imread(io.BytesIO(page.picture()))[:, :, :3] * 255).astype(int)
    seen = image[60:-60, 60:880].reshape(-1, 3)
    for one in scene.index()["classes"]:
        colour = [int(one["colour"][k : k + 2], 16) for k in (1, 3, 5)]
        assert (np.abs(seen - colour).max(axis=1) <= 2).sum() > 20, one


def test_a_click_finds_the_echo_that_a_tree_finds(page: Driven, scene: ViewedRun) -> None:
    columns = {n: np.concatenate([scene.open.read(k)[n] for k in scene.tiles]) for n in ("x", "y", "z")}
    tree = cKDTree(np.c_[columns["x"], columns["y"], columns["z"]] - scene.origin)
    picked = 0
    for x, y in page.run(PLACES)[:12]:
        hit = page.run(f"(() => {{ const h = fwclass.click({x}, {y}); return h && [h.node.node, h.row, h.place]; }})()")
        if hit:
            picked += 1
            near, _ = tree.query(hit[2])
            assert near < 0.02
            told = scene.echo(tuple(hit[0]), hit[1])["values"]
            assert np.abs(np.array([told[a] for a in "xyz"]) - scene.origin - hit[2]).max() < 0.02
    assert picked >= 5 and page.run("fwclass.stats.pick") < 500


SPANS = """(() => {
  const span = document.querySelector('#why .span'), all = span.getBoundingClientRect();
  const [bar, line] = ['div', 'i'].map((kind) => span.querySelector(kind).getBoundingClientRect());
  return [bar.left, bar.right, line.left + 1].map((at) => (at - all.left) / all.width);
})()"""
"""Both ends of the first class's bar of the first feature, and the line, as shares of the space for them."""


@pytest.mark.slow
def test_the_waveform_and_the_votes_are_the_stores(page: Driven, scene: ViewedRun, run: Path) -> None:
    hit = None
    for x, y in page.run(PLACES):
        hit = hit or page.run(f"Boolean(fwclass.click({x}, {y}))")
    page.until("fwclass.stats.wave && fwclass.stats.why && fwclass.stats.echo")
    page.run("new Promise((done) => setTimeout(done, 1500))")
    values, wave, why = (page.run(f"fwclass.stats.{n}") for n in ("echo", "wave", "why"))
    values = values["values"]
    assert values["pulse"] == wave["pulse"] and values["strip"] == wave["strip"]
    stored = scene.delivery.waveform(values["strip"], values["pulse"])
    assert wave["samples"] == stored.samples.tolist() and np.allclose(wave["time"], stored.time, atol=1e-3)
    store = Store(run, read_only=True)
    inputs, found = PartInputs(store), []
    for receipt in store.receipts("decompose"):
        table = inputs.table("decompose", receipt.part)
        rows = np.flatnonzero((table["strip"] == values["strip"]) & (table["pulse"] == values["pulse"]))
        found += [(float(table["amplitude"][r]), float(table["width"][r])) for r in rows]
    told = sorted((e["amplitude"], e["width"]) for e in wave["echoes"])
    assert np.allclose(told, sorted(found), rtol=1e-4)
    shares = scene.delivery.explain((values["strip"], values["pulse"], values["echo_number"])).shares
    assert why["shares"] == pytest.approx(shares)
    called = {c["name"]: c["code"] for c in scene.index()["classes"]}
    assert called[why["given"]] == values["classification"]
    model = load_model(scene.delivery.path / "model")
    sample, first = survey_sample(inputs, model.features), why["features"][0]
    column = sample.X[:, model.features.index(first["name"])]
    for name, side in ((why["given"], "own"), (why["other"], "others")):
        rows = column[sample.y == [c.name for c in model.classes].index(name)]
        ends = np.nanquantile(rows, (0.05, 0.5, 0.95))
        assert [first[f"{side}_low"], first[side], first[f"{side}_high"]] == pytest.approx(ends.tolist(), rel=1e-6)
    drawn = page.run(SPANS)
    assert page.run("document.getElementById('panel').scrollWidth <= document.getElementById('panel').clientWidth")
    ends = [first[n] for n in ("value", "own_low", "own_high", "others_low", "others_high") if first[n] is not None]
    low, wide = min(ends), max(ends) - min(ends)
    assert drawn[0] == pytest.approx((first["own_low"] - low) / wide, abs=0.03)
    assert drawn[1] == pytest.approx((first["own_high"] - low) / wide, abs=0.05)
    assert drawn[2] == pytest.approx((first["value"] - low) / wide, abs=0.03) and page.faults == []


@pytest.mark.slow
def test_columns_strips_and_verdicts_colour(page: Driven, scene: ViewedRun) -> None:
    for name in ("entropy", "strip", "right_or_wrong", "echo_ratio_r100", "height"):
        page.run(f"fwclass.colourBy('{name}')")
        page.until("fwclass.stats.settled")
    assert page.run("fwclass.colourBy('strip').then(() => document.querySelectorAll('#legend .row').length)") == 2
    assert page.faults == []


@pytest.mark.slow
def test_classes_go_off_and_the_address_keeps_the_view(page: Driven, server: Server) -> None:
    page.run("document.querySelector('#classes input').click()")
    page.run("Object.assign(fwclass.cam, {far: 50, tilt: 0.5}); fwclass.moved()")
    page.run("new Promise((done) => setTimeout(done, 700))")
    address = page.run("location.href")
    assert "without=" in address and "token=" in address
    page.open(address)
    page.until("window.fwclass.stats.settled")
    assert page.run("[fwclass.cam.far, fwclass.cam.tilt]") == [50, 0.5]
    assert not page.run("document.querySelector('#classes input').checked")


@pytest.mark.slow
def test_section_measure_keys_and_work_list(page: Driven) -> None:
    page.run("fwclass.tool('section'); fwclass.click(300, 400); fwclass.click(650, 400)")
    page.until("fwclass.state.section.echoes.length > 20")
    page.run("fwclass.tool('measure')")
    clicked = 0
    for x, y in page.run(PLACES):
        clicked += page.run(f"fwclass.state.tool ? Boolean(fwclass.click({x}, {y})) : false")
    assert clicked == 2 and "sideways" in page.run("document.getElementById('says').textContent")
    far = page.run("fwclass.cam.far")
    page.ask("Input.dispatchKeyEvent", type="keyDown", key="+", text="+")
    assert page.run("fwclass.cam.far") < far
    page.run("fwclass.step(1)")
    page.until("/1 of/.test(document.getElementById('place').textContent)")
    assert page.faults == []


@pytest.mark.slow
def test_a_mouse_turns_and_asks(page: Driven) -> None:
    """Events of a hand, not the page's own functions."""
    before = page.run("fwclass.cam.azimuth")
    page.drag(400, 400, 60, 0)
    assert page.run("fwclass.cam.azimuth") != before
    assert page.run("document.getElementById('picked').hidden")  # who drags asks for nothing
    page.until("fwclass.stats.settled")
    for x, y in page.run(PLACES):
        page.click(x, y)
        if page.run("fwclass.state.selected !== null"):
            break
    page.until("!document.getElementById('picked').hidden")


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_lies_outside_the_window(page: Driven, width: int) -> None:
    page.size(width)
    page.run("new Promise((done) => setTimeout(done, 500))")
    assert page.run("document.documentElement.scrollWidth") <= width
    inside = (
        "[...document.querySelectorAll('#panel *')].every((e) => e.getBoundingClientRect().right <= innerWidth + 1)"
    )
    assert page.run(inside)


@pytest.mark.slow
def test_a_lost_context_comes_back_and_no_token_is_told(page: Driven, server: Server) -> None:
    page.run("window.lose = document.getElementById('view').getContext('webgl2').getExtension('WEBGL_lose_context')")
    page.run("lose.loseContext()")
    page.run("new Promise((done) => setTimeout(() => { lose.restoreContext(); setTimeout(done, 500); }, 200))")
    page.run("fwclass.moved()")
    page.until("fwclass.stats.drawn > 0 && document.getElementById('fault').hidden")
    assert page.run("fwclass.stats.drawn") > 0 and page.run("document.getElementById('fault').textContent") == ""
    page.open(server.address.split("#")[0])
    page.until("/token/.test(document.getElementById('fault').textContent)")
    assert not page.run("document.getElementById('fault').hidden") and page.run("fwclass.stats.drawn") == 0


@pytest.mark.slow
def test_two_runs_with_deliveries_of_other_names_side_by_side(browser_page: Driven, small_run: Path) -> None:
    other = shutil.copytree(small_run, small_run.parent / "other", symlinks=True)
    deliver(small_run.parent, "publish.figure_pixels=201")
    params = conf.section("view", ())
    scenes = scenes_of(small_run, other, params)
    assert scenes[0].name != scenes[1].name
    with Server(scenes, params) as server:
        threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
        browser_page.faults.clear()
        browser_page.open(server.address)
        browser_page.until("window.fwclass.stats.settled")
        assert browser_page.run("fwclass.stats.drawn") == 2 * scenes[0].echoes
        assert browser_page.faults == []
        server.shutdown()


def test_two_runs_side_by_side(browser_page: Driven, run: Path) -> None:
    """A run beside itself: nothing differs, twice the echoes, and a click on the right asks the right one."""
    scenes = scenes_of(run, run, conf.section("view", ()))
    with Server(scenes, conf.section("view", ())) as server:
        threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
        browser_page.faults.clear()
        browser_page.open(server.address)
        browser_page.until("window.fwclass.stats.settled")
        assert browser_page.run("fwclass.stats.drawn") == 2 * scenes[0].echoes
        browser_page.run("fwclass.colourBy('differs')")
        browser_page.until("fwclass.stats.settled")
        seen = "[...new Set(fwclass.shown().flatMap((v) => v.nodes.flatMap((n) => [...n.extra])))]"
        assert browser_page.run(seen) == [1]
        assert browser_page.faults == []
        server.shutdown()


@pytest.mark.slow
def test_what_differs_does_not_depend_on_the_size_of_tiles(small_run: Path) -> None:
    """The same survey in tiles of another size: no echo is in one run alone, and both runs say the same."""
    other = small_run.parent / "other"
    shutil.copytree(small_run, other, symlinks=True)
    deliver(small_run.parent, "tile.size=70")
    scenes = scenes_of(small_run, other, conf.section("view", ()))
    assert set(scenes[0].tiles) != set(scenes[1].tiles)
    told = [np.concatenate([s.columns.of_tile(key, "differs") for key in s.tiles]) for s in scenes]
    assert np.bincount(told[0], minlength=3).tolist() == np.bincount(told[1], minlength=3).tolist()
    assert 0 not in told[0] and (told[0] == 1).mean() > 0.9


@pytest.mark.slow
def test_an_echo_is_told_with_its_class_in_the_other_run(small_run: Path) -> None:
    """Which has tiles of another size and another model; the other's table tells the truth."""
    other = small_run.parent / "other"
    shutil.copytree(small_run, other, symlinks=True)
    deliver(small_run.parent, "tile.size=70", "train.trees=1")
    scene, delivery = scenes_of(small_run, other, conf.section("view", ("view.block=1000",)))[0], open_run(other)
    mine, theirs = (_echoes(d) for d in (scene.delivery, delivery))
    assert mine.keys() == theirs.keys()
    for key in scene.tiles:
        for node in scene.open.tile(key).nodes:
            about = scene.echo(node, 0)
            truth = theirs[tuple(about["values"][n] for n in IDENTITY)]
            assert about["other"] == {n: truth[n] for n in ("classification", "confidence")}
    differing = [who for who in mine if mine[who]["classification"] != theirs[who]["classification"]]
    for who in differing[:20]:
        assert same_echo(delivery, mine[who])["classification"] == theirs[who]["classification"]
    assert differing and same_echo(delivery, {**mine[differing[0]], "pulse": 2**31}) is None


def _echoes(delivery: Delivery) -> dict[tuple[int, ...], dict[str, Any]]:
    rows = delivery.echoes(columns=[*IDENTITY, "x", "y", "z", "classification", "confidence"]).to_arrow().to_pylist()
    return {tuple(r[n] for n in IDENTITY): r for r in rows}
