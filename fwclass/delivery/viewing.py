"""`fwclass view`: runs served to a browser."""

from __future__ import annotations

import threading
import webbrowser
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from fwclass.delivery.opened import open_run
from fwclass.delivery.viewed import ViewedRun
from fwclass.delivery.viewed_command import LastCommand
from fwclass.store.run_location import RunLocation
from fwclass.view.params import ViewParams
from fwclass.view.server import Server


def scenes_of(run: RunLocation, against: RunLocation | None, params: ViewParams) -> list[ViewedRun]:
    """The scene of a run, and that of another with which it is compared."""
    first = open_run(run)
    if against is None:
        return [ViewedRun(first, params)]
    second = open_run(against)
    return [ViewedRun(first, params, second), ViewedRun(second, params, first)]


def serve_view(
    run: RunLocation,
    params: ViewParams,
    port: int,
    against: RunLocation | None,
    browser: bool,
    tell: Callable[[str], object],
    allow_run: bool = False,
    places: Path | None = None,
) -> None:
    """Serve a run until the command is interrupted; `tell` is told the address. With `allow_run` the page may start the
    run's last command. The places of the file `places` are the work list, not those of unsure echoes.

    `InputError`: `run` or `against` is no run that has delivered. `ConfigError`: the port is taken.
    """
    scenes = scenes_of(run, against, params)
    if places is not None:
        for scene in scenes:
            scene.list_places(places)
    again = LastCommand(scenes[0].delivery.root, allow_run)
    with Server(scenes, params, port, again) as server, closing(again):
        for scene in scenes:
            threading.Thread(target=scene.prepare, daemon=True).start()
        if allow_run:
            tell(f"the page may start: {again.state()['command'] or again.state()['why']}")
        tell(server.address)
        if browser and not _open_browser(server.address):
            tell("no browser could be started: open the address above")
        serving = threading.Thread(target=server.serve_forever, daemon=True)
        serving.start()
        try:
            while serving.is_alive():  # nothing else is done here: an interrupt amid a request was lost now and then
                serving.join(0.5)
        except KeyboardInterrupt:
            pass
        finally:
            if serving.is_alive():  # or it would be waited for without end
                server.shutdown()


def _open_browser(address: str) -> bool:
    try:
        return webbrowser.open(address)
    except webbrowser.Error:
        return False
