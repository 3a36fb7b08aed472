"""What the server asks of a run; whoever binds the viewer to one answers it."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Condition
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


class Cache:
    """Answers that are kept up to a number of bytes, the longest unused ones go; each is made once at a time."""

    def __init__(self, most: int) -> None:
        self.most, self.held = most, 0
        self._kept: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._under_way: set[Hashable] = set()
        self._changed = Condition()

    def get(self, key: Hashable, make: Callable[[], Any], size: Callable[[Any], int] = len) -> Any:
        """What `make` gives; `size` tells its bytes. What raises is not kept."""
        with self._changed:
            while key in self._under_way:
                self._changed.wait()
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key][0]
            self._under_way.add(key)
        try:
            value = make()
            self._keep(key, value, size(value))
            return value
        finally:
            with self._changed:
                self._under_way.discard(key)
                self._changed.notify_all()

    def _keep(self, key: Hashable, value: Any, size: int) -> None:
        with self._changed:
            self._kept[key] = value, size
            self.held += size
            while self.held > self.most and len(self._kept) > 1:
                _, (_, freed) = self._kept.popitem(last=False)
                self.held -= freed
