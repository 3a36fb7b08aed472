"""The page and what it shows as files, for any web server: the same names that the viewer's own server answers."""

from __future__ import annotations

import html
import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from fwclass.errors import FwclassError
from fwclass.view.guard import CONTENT
from fwclass.view.pyramid import Node
from fwclass.view.scene import ECHOES, Scene
from fwclass.view.server import page_files

SPANNED = ("z", "confidence", "height_above_ground", "intensity")
"""Columns that blocks have, and whose colours span what `Scene.scale` says."""

IDENTITIES = "identity"
"""Blocks that say who the echoes of a node are: `blocks.identity_block`."""


@dataclass(frozen=True)
class UnsureEcho:
    """An unsure echo of which the folder has everything.

    Attributes
    ----------
    node, row : its place in a block.
    strip, pulse, echo_number : who it is.
    place : x, y, z relative to the scene's origin [m].
    about : what `Scene.echo` says of it.
    """

    node: Node
    row: int
    strip: int
    pulse: int
    echo_number: int
    place: tuple[float, float, float]
    about: dict[str, Any]

    @property
    def name(self) -> str:
        """Strip, pulse and echo number, as files are named."""
        return f"{self.strip}-{self.pulse}-{self.echo_number}"


class WholeScene(Scene, Protocol):
    """A scene that knows all of its blocks, so that it can be written out."""

    def colours(self) -> Sequence[str]:
        """Columns that are written, besides what a block has."""

    def nodes(self) -> Iterator[Node]:
        """Every node with an echo, tile after tile, in the order in which `level` gives them."""

    def identities(self, node: Node) -> bytes:
        """Who the echoes of a node are."""

    def unsure_echoes(self) -> Sequence[Sequence[UnsureEcho]]:
        """Echoes of every place of `work`, the least sure first."""


def write_folder(scenes: Sequence[WholeScene], directory: Path, tell: Callable[[str], object]) -> None:
    """Write the page and its scenes to an empty directory; `tell` is told how far it is."""
    for name, body in page_files().items():
        (directory / name).write_bytes(_served_anywhere(body) if name == "index.html" else body)
    for number, scene in enumerate(scenes):
        here = directory / "data" / str(number)
        here.mkdir(parents=True)
        index, columns = scene.index(), list(scene.colours())
        tell(f"blocks of {index['echoes']:,} echoes")
        nodes = _write_blocks(scene, index["together"], columns, here)
        unsure = scene.unsure_echoes()
        tell(f"{sum(map(len, unsure)):,} unsure echoes")
        work, lacking = scene.work(), Counter[str]()
        recorded = {*index["waveforms"]["strips"], *index["waveforms"]["lost"]}
        for place, echoes in zip(work["places"], unsure, strict=True):
            place["told"] = [{"node": t.node, "row": t.row, "echo": t.name, "place": t.place} for t in echoes]
            for one in echoes:
                lacking.update(_write_echo(scene, one, one.strip in recorded, here))
        for why, echoes_without in lacking.items():
            tell(f"{echoes_without:,} of them are shown without what is lacking: {why}")
        _write_json(here / "work.json", work)
        names = [t.name for echoes in unsure for t in echoes]
        folder = {"nodes": nodes, "columns": columns, "told": names}
        _write_json(here / "index.json", {**index, "relabels": False, "folder": folder})


def _served_anywhere(page: bytes) -> bytes:
    """The page with the policy that the viewer's own server sends as headers; only those know `frame-ancestors`."""
    policy = "; ".join(p for p in CONTENT.split("; ") if not p.startswith("frame-ancestors"))
    head = f'<meta http-equiv="Content-Security-Policy" content="{html.escape(policy)}">\n'
    head += '<meta name="referrer" content="no-referrer">\n'
    first = b'<meta charset="utf-8">\n'
    return page.replace(first, first + head.encode(), 1)


def _write_blocks(scene: WholeScene, together: Sequence[int], columns: Sequence[str], here: Path) -> list[str]:
    """All blocks; names of the nodes that have files of their own."""
    parts, own = (ECHOES, *columns), []
    for part in (*parts, IDENTITIES):
        (here / part).mkdir()
    for part in parts:
        for level in together:
            (here / part / f"level-{level}.bin").touch()
    for part in (*columns, *SPANNED):
        (here / part).mkdir(exist_ok=True)
        _write_json(here / part / "scale.json", scene.scale(part))
    for node in scene.nodes():
        name = "-".join(map(str, node))
        (here / IDENTITIES / f"{name}.bin").write_bytes(scene.identities(node))
        if node[0] not in together:
            own.append(name)
        for part in parts:
            block = scene.node(part, node)
            if node[0] in together:
                with (here / part / f"level-{node[0]}.bin").open("ab") as file:
                    file.write(block)
            else:
                (here / part / f"{name}.bin").write_bytes(block)
    return own


def _write_echo(scene: WholeScene, echo: UnsureEcho, recorded: bool, here: Path) -> list[str]:
    """Write what is known of an echo; what is not, in words. `recorded`: its strip has, or had, waveforms."""
    at = here / "echo" / "-".join(map(str, echo.node)) / f"{echo.row}.json"
    at.parent.mkdir(parents=True, exist_ok=True)
    _write_json(at, echo.about)
    pulse, why = here / "pulse" / f"{echo.strip}-{echo.pulse}.json", here / "why" / f"{echo.name}.json"
    for path in (pulse, why):
        path.parent.mkdir(exist_ok=True)
    if recorded and not pulse.exists():  # of two echoes of one pulse
        _write_json(pulse, _answer(lambda: scene.pulse(echo.strip, echo.pulse)))
    _write_json(why, _answer(lambda: scene.why(echo.strip, echo.pulse, echo.echo_number)))
    answers = (json.loads(path.read_bytes()) for path in ((pulse, why) if recorded else (why,)))
    return [str(answer["error"]) for answer in answers if "error" in answer]


def _answer(ask: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What a scene answers, or why it does not, without a path of this host."""
    try:
        return ask()
    except FwclassError as fault:
        return {"error": fault.what}


def _write_json(path: Path, value: Any) -> None:
    path.write_bytes(json.dumps(value, allow_nan=False, separators=(",", ":")).encode())
