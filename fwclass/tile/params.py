"""Parameters of the tiles."""

from __future__ import annotations

from pydantic import Field

from fwclass.params import Params


class TileParams(Params):
    """`size`: edge of a tile [m], at least 5. It never changes a result, only what one part holds."""

    size: float = Field(ge=5.0, le=100_000)
