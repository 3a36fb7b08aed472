"""How object storage is talked to; the numbers stand in `conf/base.yaml`."""

from __future__ import annotations

from pydantic import Field, model_validator

from fwclass.params import Params


class StoreParams(Params):
    """Section `store`; never changes a result, and a run in a local directory over local files needs none of it.

    Attributes
    ----------
    scratch : directory of every host for copies of what is read; None: the Dask worker's own, else the user's cache.
        The environment's FWCLASS_SCRATCH goes before all of them.
    scratch_gib : what one process may keep there [GiB]; what was not read for longest goes first.
    timeout : of one request [s].
    patience : how long a request that fails is tried again [s].
    chunk_mib : what is transferred in one request [MiB].
    parallel : requests that one process makes at a time.
    beat : how often the holder of a run's lock renews it [s].
    dead : a lock that was not renewed for so long, by the watch of who waits for it, is taken over [s].
    """

    scratch: str | None
    scratch_gib: float = Field(gt=0, le=1_000_000)
    timeout: float = Field(gt=0, le=86_400)
    patience: float = Field(ge=0, le=86_400)
    chunk_mib: int = Field(ge=5, le=5_120)
    parallel: int = Field(ge=1, le=256)
    beat: float = Field(gt=0, le=86_400)
    dead: float = Field(gt=0, le=604_800)

    @model_validator(mode="after")
    def _fit(self) -> StoreParams:
        if self.dead < 3 * self.beat:
            raise ValueError("store.dead must be three beats at least, or a slow network looks like a dead run")
        return self
