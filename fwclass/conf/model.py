"""The sections of a configuration, and the whole of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from fwclass.assess.stage import AssessParams
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.pulse_sample import PulseParams
from fwclass.features.stage import FeaturesParams
from fwclass.grid import Box
from fwclass.ground.auto import GroundAutoParams
from fwclass.ground.params import GroundParams
from fwclass.ground.search import GroundSearchParams
from fwclass.ground.terrain.terrain import TerrainParams
from fwclass.label.stage import LabelParams
from fwclass.model import ClassDef
from fwclass.publish.params import PublishParams
from fwclass.radiometry.params import RadiometryParams
from fwclass.read.stage import ReadParams
from fwclass.simulate.params import SimulateParams
from fwclass.tile.stage import TileParams
from fwclass.train.stage import TrainParams


class Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class ClassSection(Section):
    """One class: its name, the code it is delivered as, the reference codes that count as it.

    `legacy_code` (0 to 31) is written where a source strip has a point format (0-5) that cannot hold `code`.
    """

    name: str
    code: int
    codes: tuple[int, ...]
    legacy_code: int | None = None


class ReferenceSection(Section):
    """Where reference classes come from: `source` (the files' own classes), `cloud` (other files) or `none`."""

    kind: Literal["source", "cloud", "none"]
    files: tuple[str, ...] = ()


class SurveySection(Section):
    """What is classified.

    `directory` is relative to the survey's file; null: simulated into the run directory. `crs`, if given, is used for
    all files, whatever they name; `none` goes without. `features`: columns the forest decides by. `model`: directory
    of a trained model to use instead of training, or null.
    """

    name: str = Field(pattern=r"^\w[\w .-]*$")
    directory: str | None
    sources: tuple[str, ...] = Field(min_length=1)
    crs: str | None
    reference: ReferenceSection
    trajectory: TrajectorySection
    features: tuple[str, ...] = Field(min_length=1)
    model: str | None
    classes: tuple[ClassSection, ...]


class TrajectorySection(Section):
    """Where the sensor flew: files (text or SBET), and the height of the survey's zero above the ellipsoid [m], taken
    from their heights."""

    files: tuple[str, ...]
    undulation: float


class AreasSection(Section):
    """Where to train and where to test, boxes [xmin, ymin, xmax, ymax) [m].

    `test` empty: all that lies further than `gap` from every training box. `gap` also keeps listed test boxes apart.
    """

    train: tuple[tuple[float, float, float, float], ...]
    test: tuple[tuple[float, float, float, float], ...]
    gap: float = Field(ge=0)

    def boxes(self, name: Literal["train", "test"]) -> tuple[Box, ...]:
        return tuple(Box(*b) for b in getattr(self, name))


class RunSection(Section):
    """Where it runs; never changes a result.

    `seam_check_echoes`: a survey of at most so many echoes is filtered once more as one block, to tell in the report
    what the seams between blocks changed; 0 leaves the check out.
    """

    workers: int = Field(ge=0)
    worker_memory_gib: float = Field(gt=0)
    seam_check_echoes: int = Field(ge=0)


PARAMS: dict[str, type[BaseModel]] = {
    "survey": SurveySection,
    "areas": AreasSection,
    "run": RunSection,
    "simulate": SimulateParams,
    "read": ReadParams,
    "pulse": PulseParams,
    "decompose": DecomposeParams,
    "tile": TileParams,
    "label": LabelParams,
    "ground": GroundParams,
    "ground_auto": GroundAutoParams,
    "ground_search": GroundSearchParams,
    "terrain": TerrainParams,
    "features": FeaturesParams,
    "radiometry": RadiometryParams,
    "train": TrainParams,
    "assess": AssessParams,
    "publish": PublishParams,
}


@dataclass(frozen=True)
class Config:
    """A whole, checked configuration and the file it came from."""

    path: Path
    raw: Mapping[str, Any]
    survey: SurveySection
    areas: AreasSection
    run: RunSection
    simulate: SimulateParams | None
    read: ReadParams
    pulse: PulseParams
    decompose: DecomposeParams
    tile: TileParams
    label: LabelParams
    ground: GroundParams
    ground_auto: GroundAutoParams
    ground_search: GroundSearchParams
    terrain: TerrainParams
    features: FeaturesParams
    radiometry: RadiometryParams
    train: TrainParams
    assess: AssessParams
    publish: PublishParams

    @property
    def classes(self) -> tuple[ClassDef, ...]:
        return tuple(ClassDef(c.name, c.code, c.codes) for c in self.survey.classes)

    @property
    def simulated(self) -> bool:
        """The survey has no files of its own: it is simulated into the run directory."""
        return self.survey.directory is None
