"""What the server asks of a run; whoever binds the viewer to one answers it."""

from __future__ import annotations

from typing import Any, Protocol

from fwclass.view.pyramid import Node

ECHOES = "echoes"
"""The part of a scene that holds the blocks; every other part is a column."""


class Scene(Protocol):
    """A run as it is shown. Answers are plain data for JSON, or blocks as `blocks` makes them, one after another.

    Every method raises `InputError` for what the run does not have.
    """

    def index(self) -> dict[str, Any]:
        """Tiles, levels, classes, columns, and what else the page has to know before it draws."""

    def scale(self, part: str) -> dict[str, Any]:
        """What the bytes of a column stand for."""

    def level(self, part: str, level: int) -> bytes:
        """All blocks of a level."""

    def node(self, part: str, node: Node) -> bytes:
        """The block of a node; one without an echo where nothing lies."""

    def echo(self, node: Node, row: int) -> dict[str, Any]:
        """All that the delivery says of an echo of a node's block."""

    def pulse(self, strip: int, pulse: int) -> dict[str, Any]:
        """The waveform of a pulse with its fit."""

    def why(self, strip: int, pulse: int, echo_number: int) -> dict[str, Any]:
        """Why an echo has its class."""

    def work(self) -> dict[str, Any]:
        """Places where the classes are unsure, the largest first."""
