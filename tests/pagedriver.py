"""A page in headless Chromium with software GL, driven and looked at: scripts, mouse, pictures, requests, faults."""

from __future__ import annotations

import asyncio
import base64
import json
import os
import subprocess
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from browser import browser, debugging_port

FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--hide-scrollbars",
    "--remote-debugging-port=0",
]


class Driven:
    """One page. `requests`: addresses asked for; `faults`: what its console was told, and its unhandled errors."""

    def __init__(self, loop: asyncio.AbstractEventLoop, socket: Any) -> None:
        self._loop, self._socket, self._number = loop, socket, 0
        self.requests: list[str] = []
        self.faults: list[str] = []
        for domain in ("Network", "Page", "Runtime", "Log"):
            self.ask(f"{domain}.enable")

    def ask(self, method: str, **params: Any) -> Any:
        return self._loop.run_until_complete(self._ask(method, params))

    async def _ask(self, method: str, params: Any) -> Any:
        self._number += 1
        mine = self._number
        await self._socket.write_message(json.dumps({"id": mine, "method": method, "params": params}))
        while True:
            said = json.loads(await asyncio.wait_for(self._socket.read_message(), 120))
            self._note(said)
            if said.get("id") == mine:
                assert "error" not in said, said
                return said["result"]

    def _note(self, said: Any) -> None:
        about = said.get("params", {})
        if said.get("method") == "Network.requestWillBeSent":
            self.requests.append(about["request"]["url"])
        elif said.get("method") == "Runtime.exceptionThrown":
            self.faults.append(str(about["exceptionDetails"])[:500])
        elif said.get("method") == "Log.entryAdded" and about["entry"]["level"] == "error":
            self.faults.append(f"{about['entry']['text']} {about['entry'].get('url', '')}")
        elif said.get("method") == "Runtime.consoleAPICalled" and about["type"] in ("error", "warning"):
            self.faults.append(str(about["args"])[:500])

    def size(self, width: int, height: int = 800) -> None:
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def open(self, address: str) -> None:
        self.ask("Page.navigate", url="about:blank")
        self.ask("Page.navigate", url=address)

    def run(self, script: str) -> Any:
        """The value of a script, waited for where it is a promise."""
        got = self.ask("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in got, got
        return got["result"].get("value")

    def until(self, script: str, seconds: float = 60.0) -> Any:
        end = time.monotonic() + seconds
        while not (value := self.run(f"(() => {{ try {{ return {script}; }} catch {{ return null; }} }})()")):
            shown = self.run("document.body?.innerText?.slice(0, 300)")
            assert time.monotonic() < end, f"{script} stays {value}; {shown}; {self.faults}"
            time.sleep(0.05)
        return value

    def click(self, x: float, y: float) -> None:
        for kind in ("mousePressed", "mouseReleased"):
            self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1, buttons=1)

    def drag(self, x: float, y: float, dx: float, dy: float) -> None:
        for kind, k in (("mousePressed", 0), ("mouseMoved", 0.5), ("mouseMoved", 1), ("mouseReleased", 1)):
            at = {"x": x + k * dx, "y": y + k * dy}
            self.ask("Input.dispatchMouseEvent", type=kind, button="left", buttons=1, clickCount=1, **at)

    def picture(self) -> bytes:
        """PNG of what the window shows."""
        return base64.b64decode(self.ask("Page.captureScreenshot")["data"])


@contextmanager
def running(server: Any) -> Iterator[Any]:
    """A server that answers in a thread of its own until it is left."""
    with server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


@contextmanager
def driven(width: int = 1280) -> Iterator[Driven]:
    """A browser with one empty page."""
    from tornado.websocket import websocket_connect

    command = browser()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as home:
        words = [command, *FLAGS, f"--user-data-dir={home}", "about:blank"]
        process = subprocess.Popen(
            words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env={**os.environ, "TMPDIR": home}
        )
        loop = asyncio.new_event_loop()
        try:
            port = debugging_port(Path(home))
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
                target = next(t for t in json.load(answer) if t["type"] == "page")

            async def connected() -> Any:
                return await websocket_connect(target["webSocketDebuggerUrl"], max_message_size=1 << 28)

            page = Driven(loop, loop.run_until_complete(connected()))
            page.size(width)
            yield page
        finally:
            process.terminate()
            process.wait(30)
            loop.close()
