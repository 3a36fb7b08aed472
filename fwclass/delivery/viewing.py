"""`fwclass view`: serving runs, or writing them as a folder."""

from __future__ import annotations

import threading
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from fwclass.delivery.opened import open_run
from fwclass.delivery.viewed import ViewedRun
from fwclass.view.params import ViewParams
from fwclass.view.server import Server


def serve_view(run: Path, params: ViewParams, port: int, browser: bool, tell: Callable[[str], object]) -> None:
    """Serve a run until the command is interrupted; `tell` is told the address.

    Raises
    ------
    InputError
        `run` is no run that has delivered.
    ConfigError
        The port is taken.
    """
    scene = ViewedRun(open_run(run), params)
    with Server([scene], params, port) as server:
        threading.Thread(target=scene.prepare, daemon=True).start()
        tell(server.address)
        if browser and not _opened(server.address):
            tell("no browser could be started: open the address above")
        with suppress(KeyboardInterrupt):
            server.serve_forever()


def _opened(address: str) -> bool:
    try:
        return webbrowser.open(address)
    except webbrowser.Error:
        return False
