"""What an operator meets in the viewer besides sound runs: each is said in a sentence that helps."""

from __future__ import annotations

import socket
import threading
from pathlib import Path

import pytest
from pagedriver import driven, running

from fwclass import conf
from fwclass.delivery import viewing
from fwclass.delivery.opened import open_run
from fwclass.delivery.viewed import ViewedRun
from fwclass.errors import ConfigError, InputError
from fwclass.view.scene import ECHOES
from fwclass.view.server import Server


def opened(root: Path) -> ViewedRun:
    return ViewedRun(open_run(root), conf.section("view", ("view.block=1000", "view.together=1000")))


def replaced(root: Path, data: bytes | None) -> Path:
    """The first tile's table, with other bytes, or gone."""
    path = sorted((root / "current" / "parquet").resolve().iterdir())[0]
    path.chmod(0o644)
    path.unlink()
    if data is not None:
        path.write_bytes(data)
    return path


def test_a_port_that_is_taken_is_said(small_run: Path) -> None:
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        held.listen()
        port = held.getsockname()[1]
        with pytest.raises(ConfigError, match="port cannot be had") as told:
            viewing.serve_view(small_run, conf.section("view", ()), port, None, False, print)
    assert str(port) in str(told.value) and "--port" in str(told.value)


def test_where_no_browser_starts_the_address_is_there(small_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: str) -> bool:
        raise viewing.webbrowser.Error

    said: list[str] = []
    monkeypatch.setattr(viewing.webbrowser, "open", refuse)
    monkeypatch.setattr(Server, "serve_forever", lambda server: None)
    viewing.serve_view(small_run, conf.section("view", ()), 0, None, True, said.append)
    assert said[0].startswith("http://127.0.0.1:") and "open the address above" in said[1]


@pytest.mark.parametrize("data", [None, b"PAR1"], ids=["gone", "cut"])
def test_a_tile_that_is_gone_or_cut_is_said_before_the_page_opens(small_run: Path, data: bytes | None) -> None:
    path = replaced(small_run, data)
    with pytest.raises(InputError, match="damaged") as told:
        opened(small_run)
    assert path.name in str(told.value) and "--verify" in str(told.value)


def test_a_tile_that_is_cut_under_an_open_page_is_said(small_run: Path) -> None:
    scene = opened(small_run)
    replaced(small_run, b"PAR1")
    with pytest.raises(InputError, match=r"is damaged(.|\n)*--verify"):
        for level in scene.pyramid.levels():
            scene.level(ECHOES, level)


def test_a_tile_with_one_bit_flipped_is_said_and_not_shown(small_run: Path) -> None:
    """A size as before, and a file that Parquet reads: the digest alone tells."""
    path = sorted((small_run / "current" / "parquet").resolve().iterdir())[0]
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 1
    replaced(small_run, bytes(data))
    with pytest.raises(InputError, match=r"is damaged(.|\n)*digest(.|\n)*--verify"):
        scene = opened(small_run)
        for level in scene.pyramid.levels():
            scene.level(ECHOES, level)
    with pytest.raises(InputError, match="is damaged"):
        for tile in open_run(small_run).tiles:
            open_run(small_run).table(tile["tile"])


@pytest.mark.slow
def test_sources_that_moved_change_nothing(run: Path, tmp_path: Path) -> None:
    """Waveforms, votes and classes are the run's own."""
    scene = opened(run)
    strips = next(p for p in (run.parent / "survey").rglob("strips") if p.is_dir())
    away = strips.with_name("away")
    strips.rename(away)
    try:
        row = open_run(run).echoes(columns=["strip", "pulse", "echo_number"]).to_arrow().slice(0, 1).to_pylist()[0]
        assert scene.pulse(row["strip"], row["pulse"])["samples"]
        assert scene.why(row["strip"], row["pulse"], row["echo_number"])["shares"]
    finally:
        away.rename(strips)


@pytest.mark.slow
def test_a_colour_that_cannot_be_had_is_said_and_the_one_that_is_seen_stays_chosen(small_run: Path) -> None:
    with driven() as page, running(Server([opened(small_run)], conf.section("view", ()))) as server:
        page.open(server.address)
        page.until("window.fwclass.stats.settled")
        page.run("fwclass.colourBy('intensity')")
        page.until("document.getElementById('legend').innerText.trim()")
        legend = page.run("document.getElementById('legend').innerText")
        replaced(small_run, b"PAR1")
        page.run("fwclass.colourBy('zc')")
        page.until("document.getElementById('fault').innerText.includes('is damaged')")
        assert page.run("[document.getElementById('by').value, fwclass.state.by]") == ["intensity"] * 2
        assert page.run("document.getElementById('legend').innerText") == legend and "by=intensity" in page.run(
            "location.hash"
        )


@pytest.mark.slow
def test_a_browser_without_webgl2_is_told(small_run: Path) -> None:
    params = conf.section("view", ())
    with driven() as page, Server([opened(small_run)], params) as server:
        threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
        refuse = "HTMLCanvasElement.prototype.getContext = () => null"
        page.ask("Page.addScriptToEvaluateOnNewDocument", source=refuse)
        page.open(server.address)
        page.until("document.body.innerText.includes('has no WebGL2')")
        server.shutdown()
