"""Numbers of the viewer."""

from __future__ import annotations

from pydantic import Field

from fwclass.params import Params


class ViewParams(Params):
    """Settings of the viewer; none of them changes a result.

    Attributes
    ----------
    block : echoes of a block of an average tile at most.
    together : levels of at most so many echoes are sent whole.
    whole : a survey of so many echoes, 20 000 for every tile added, is read whole for its coarse levels; a larger one
        has them from the delivered overview.
    cache : memory for blocks, and as much again for tiles that are open [MiB].
    connections : open at a time.
    request : a request is heard for so long [s], and an answer may stand still for so long.
    head : of a request [bytes].
    unsure : echoes with less confidence are places to look at.
    cluster : unsure echoes nearer than this, in squares of the global grid, are one place [m].
    place : edge of the squares of the global grid that no place reaches beyond [m].
    places : of the work list.
    export : unsure echoes of a place whose waveform, votes and columns a folder has.
    body : of a request that changes something [bytes].
    searched : echoes of the tiles that a selection may touch.
    selected : echoes of one selection.
    """

    block: int = Field(ge=1000, le=1_000_000)
    together: int = Field(ge=1000, le=10_000_000)
    whole: int = Field(ge=0, le=1_000_000_000)
    cache: int = Field(ge=1, le=1_000_000)
    connections: int = Field(ge=2, le=1000)
    request: float = Field(ge=0.1, le=3600)
    head: int = Field(ge=1024, le=1_000_000)
    unsure: float = Field(ge=0, le=1)
    cluster: float = Field(ge=0.1, le=10_000)
    place: float = Field(ge=0.1, le=100_000)
    places: int = Field(ge=1, le=100_000)
    export: int = Field(ge=0, le=10_000)
    body: int = Field(ge=1024, le=1_000_000)
    searched: int = Field(ge=1000, le=1_000_000_000)
    selected: int = Field(ge=1, le=10_000_000)
