"""A page in headless Chromium: its size, its look and its print, through the browser's debugging port."""

from __future__ import annotations

import asyncio
import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")


def browser() -> str:
    """The browser's command; skips the test where there is none, and fails it where CI must have one."""
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    if found is None:
        if os.environ.get("CI") == "true":
            pytest.fail("no Chromium: .ci/run installs it")
        pytest.skip("no Chromium here: apt-get install chromium")
    return found


class Page:
    """Width and height of the document [px], addresses that it asked for elsewhere, a picture, a PDF."""

    def __init__(self, facts: Mapping[str, Any]) -> None:
        self.width, self.height = int(facts["width"]), int(facts["height"])
        self.requests: list[str] = facts["requests"]
        self.png, self.pdf = facts["png"], facts["pdf"]


def seen(path: Path, width: int) -> Page:
    """Open a page in a window of `width` pixels."""
    command = browser()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as home:  # a browser that ends still writes
        flags = ["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--remote-debugging-port=0"]
        process = subprocess.Popen(
            [command, *flags, f"--user-data-dir={home}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "TMPDIR": home},  # of what it puts there, it removes not all
        )
        try:
            port = debugging_port(Path(home))
            return Page(asyncio.run(_visit(port, path.resolve().as_uri(), width)))
        finally:
            process.terminate()
            process.wait(30)


def debugging_port(home: Path, seconds: float = 60.0) -> str:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        place = home / "DevToolsActivePort"
        if place.exists() and place.read_text().strip():
            return place.read_text().split()[0]
        time.sleep(0.1)
    raise TimeoutError("the browser did not start")


async def _visit(port: str, address: str, width: int) -> dict[str, Any]:
    from tornado.websocket import websocket_connect

    with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
        target = next(t for t in json.load(answer) if t["type"] == "page")
    socket = await websocket_connect(target["webSocketDebuggerUrl"], max_message_size=1 << 28)
    number, requests = 0, []

    async def until(done: Callable[[Mapping[str, Any]], bool]) -> Mapping[str, Any]:
        while True:
            told = json.loads(await socket.read_message())
            if told.get("method") == "Network.requestWillBeSent":
                requests.append(told["params"]["request"]["url"])
            if done(told):
                return told

    async def ask(method: str, **params: Any) -> Any:
        nonlocal number
        number += 1
        mine = number
        await socket.write_message(json.dumps({"id": mine, "method": method, "params": params}))
        told = await until(lambda t: t.get("id") == mine)
        assert "error" not in told, told
        return told["result"]

    await ask("Network.enable")
    await ask("Page.enable")
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
    await ask("Emulation.setDeviceMetricsOverride", **size)
    await ask("Page.navigate", url=address)
    await until(lambda t: t.get("method") == "Page.loadEventFired")
    content = (await ask("Page.getLayoutMetrics"))["cssContentSize"]
    shot = await ask("Page.captureScreenshot", captureBeyondViewport=True)
    printed = await ask("Page.printToPDF", preferCSSPageSize=True)
    away = [url for url in requests if not url.startswith(("data:", "file:"))]
    png, pdf = base64.b64decode(shot["data"]), base64.b64decode(printed["data"])
    return {**content, "requests": away, "png": png, "pdf": pdf}
