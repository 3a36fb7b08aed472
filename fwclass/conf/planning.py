"""The section `plan`: what a survey costs, in numbers that `fwclass plan` multiplies by what the headers say."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from fwclass.params import Params


class StageCost(Params):
    """The cost of a stage, in the unit that its record names; numbers stand in `conf/base.yaml`.

    Attributes
    ----------
    part : time of a part that holds nothing [ms].
    each : processor time of a unit more [µs].
    stored : written for a unit, besides waveforms [bytes].
    waves : share of the waveforms' bytes that is written again.
    held : memory for a unit that the part reads, its halo's too [bytes].
    """

    part: float = Field(ge=0)
    each: float = Field(ge=0)
    stored: float = Field(ge=0)
    waves: float = Field(ge=0)
    held: float = Field(ge=0)


class PlanSection(Params):
    """How `fwclass plan` reckons; numbers stand in `conf/base.yaml`.

    Attributes
    ----------
    sample_points : of one file that are read, to see how dense it is where it was flown.
    returns_per_pulse : where nothing could be read.
    density, neighbour : of the survey that the costs were measured on [1/m²], and processor time that an echo's
        neighbourhood takes for every echo in it beyond those at this density [ns].
    feature, feature_bytes, delivered_bytes : processor time of a feature of an echo [µs], and what it takes in the
        store and in a delivered table [bytes].
    water : processor time that looking for water (`bathymetry`) takes a waveform more [µs].
    echoes_per_return : that a decomposition finds.
    wave_bytes : waveforms of a pulse that is not simulated yet [bytes].
    crowding : echoes of the fullest tile or block over those that evenly spread files give it.
    base_mib : memory of a worker that holds nothing [MiB].
    worker_share : of run.worker_memory_gib that may be planned with.
    disk_share : of the free disk that may be planned with.
    compile_seconds : once in every worker, the first time on a machine [s].
    sizes : tile sizes that are compared [m].
    tiles_per_worker : fewer leave workers idle.
    stages : cost of every stage by name.
    of_returns : of those that differ, for files without waveforms, whose echoes are their returns.
    of_ground : of those that differ, where classes are by the ground filter.
    """

    sample_points: int = Field(ge=1000, le=100_000_000)
    returns_per_pulse: float = Field(ge=1, le=1000)
    density: float = Field(gt=0, le=1e6)
    neighbour: float = Field(ge=0, le=1e6)
    feature: float = Field(ge=0, le=1e6)
    feature_bytes: float = Field(ge=0, le=1e6)
    delivered_bytes: float = Field(ge=0, le=1e6)
    water: float = Field(ge=0, le=1e6)
    echoes_per_return: float = Field(gt=0, le=1000)
    wave_bytes: float = Field(ge=0)
    crowding: float = Field(ge=1, le=1000)
    base_mib: float = Field(ge=0)
    worker_share: float = Field(gt=0, le=1)
    disk_share: float = Field(gt=0, le=1)
    compile_seconds: float = Field(ge=0)
    sizes: tuple[Annotated[float, Field(ge=5, le=100_000)], ...] = Field(min_length=1, max_length=100)
    tiles_per_worker: int = Field(ge=1, le=1_000_000)
    stages: dict[str, StageCost]
    of_returns: dict[str, StageCost]
    of_ground: dict[str, StageCost]
