"""Runs served to a page of the viewer in headless Chromium, and what its tests do with it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pagedriver import Driven, running

from fwclass import conf
from fwclass.delivery.viewing import scenes_of
from fwclass.view.server import Server

PICK = """(() => { const v = document.getElementById('view'), w = v.clientWidth, h = v.clientHeight;
for (let k = 0; k < 80; k += 1)
if (fwclass.click(w * (0.3 + 0.4 * ((k * 7) % 13) / 13), h * (0.35 + 0.3 * ((k * 5) % 11) / 11))) return true;
return false; })()"""
"""A click that finds an echo."""


SECTION = """(() => { const v = document.getElementById('view'), n = fwclass.scenes().length;
fwclass.tool('section'); for (const k of [0.35, 0.65]) fwclass.click(v.clientWidth * k / n, v.clientHeight / 2); })()"""
PIXELS = """(() => { const c = document.getElementById('cut'), out = {};
const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
for (let k = 0; k < d.length; k += 4) if (d[k + 3]) { const rgb = d.slice(k, k + 3).join();
out[rgb] = (out[rgb] || 0) + 1; } return out; })()"""
"""How many pixels of the section have which colour."""


@contextmanager
def served(root: Path, against: Path | None = None, *settings: str) -> Iterator[Server]:
    params = conf.section("view", settings)
    with running(Server(scenes_of(root, against, params), params)) as server:
        yield server


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
