"""What the server asks of a run; whoever binds the viewer to one answers it."""

from __future__ import annotations

from typing import Any, Protocol

from fwclass.errors import InputError
from fwclass.view.pyramid import Node
from fwclass.view.selection import Selection

ECHOES = "echoes"
"""The part of a scene that holds the blocks; every other part is a column."""


class Replaced(InputError):
    """What the page shows is not the run's current delivery any more."""


class Gone(InputError):
    """The run has no delivery any more."""


class Relabel(Protocol):
    """Corrections of a run: what is selected is resolved on all delivered echoes, whichever the page has."""

    def begin(self) -> dict[str, Any]:
        """What the page must know before it draws; a fault where nothing can be written."""

    def select(self, selection: Selection) -> dict[str, Any]:
        """How many echoes are selected, in how many tiles, and a number by which they are known hereafter."""

    def marks(self, number: int) -> bytes:
        """The selected echoes, as rows of blocks (`blocks.marks`)."""

    def correct(self, number: int, code: int | None) -> dict[str, Any]:
        """Write the class `code` (None: what was corrected is taken back) of the selected echoes."""

    def revert(self, time: int) -> dict[str, Any]:
        """Take back what `correct` or `revert` wrote at `time`."""

    def changes(self, known: int) -> bytes:
        """Classes of echoes that were changed after the first `known` rows; see `blocks.marks`."""


class Again(Protocol):
    """The run's last command, to be given once more."""

    def start(self) -> dict[str, Any]:
        """As `state`; a fault where that was not allowed, or it is under way."""

    def stop(self) -> dict[str, Any]:
        """As `state`; interrupted as by Ctrl-C, killed when it was asked for a second time."""

    def state(self) -> dict[str, Any]:
        """The command in words, whether it may be started here and runs, its last lines, how it ended."""


class Scene(Protocol):
    """A run as it is shown. Answers are plain data for JSON, or blocks as `blocks` makes them, one after another.

    Every method raises `InputError` for what the run does not have.
    """

    @property
    def relabel(self) -> Relabel:
        """Corrections of the run."""

    @property
    def name(self) -> str:
        """Of the delivery: a page that began with another one is refused."""

    def reopened(self) -> Scene:
        """The scene of the delivery that is current now."""

    def index(self) -> dict[str, Any]:
        """Tiles, levels, classes, columns, and what else the page has to know before it draws."""

    def scale(self, part: str) -> dict[str, Any]:
        """What the bytes of a column stand for: kinds, or numbers from `low` to `high`, which its colours span."""

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
