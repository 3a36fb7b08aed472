"""The whole of a configuration: its sections by name, and what it is once checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from fwclass.assess.params import AssessParams
from fwclass.classes import ClassDef
from fwclass.classify.params import ClassifyParams
from fwclass.conf.planning import PlanSection
from fwclass.conf.schedule import ScheduleSection
from fwclass.conf.sections import AreasSection, PapersSection, RunSection, SeamsSection, SurveySection
from fwclass.conf.sets import Selection, feature_set, listed_once
from fwclass.contours.params import ContourParams
from fwclass.decompose.params import (
    BathymetryParams,
    DecomposeParams,
    PlausibilityParams,
    PulseParams,
    SampleParams,
    StackParams,
)
from fwclass.errors import ConfigError
from fwclass.features.params import FeaturesParams
from fwclass.ground.params import GroundParams
from fwclass.ground.terrain.params import TerrainParams
from fwclass.ground.tuning_params import GroundAutoParams, GroundSearchParams
from fwclass.label.params import LabelParams, SuggestParams
from fwclass.params import ShapeFileParams
from fwclass.publish.params import PublishParams
from fwclass.quality.params import QualityParams
from fwclass.radiometry.params import RadiometryParams
from fwclass.read.params import ReadParams
from fwclass.select.params import SelectParams
from fwclass.simulate.params import SimulateParams
from fwclass.store.params import StoreParams
from fwclass.street.params import StreetParams, StreetSceneParams
from fwclass.thin.params import ThinParams
from fwclass.tile.params import TileParams
from fwclass.train.baselines.params import CompareParams
from fwclass.train.params import AdaptParams, TrainParams
from fwclass.vectors.params import VectorParams
from fwclass.view.params import ViewParams
from fwclass.voxels.params import ProfileParams, VoxelParams
from fwclass.water.params import WaterParams

PARAMS: dict[str, type[BaseModel]] = {
    "survey": SurveySection,
    "areas": AreasSection,
    "run": RunSection,
    "store": StoreParams,
    "plan": PlanSection,
    "seams": SeamsSection,
    "schedule": ScheduleSection,
    "simulate": SimulateParams,
    "read": ReadParams,
    "pulse": PulseParams,
    "decompose": DecomposeParams,
    "bathymetry": BathymetryParams,
    "plausibility": PlausibilityParams,
    "stack": StackParams,
    "samples": SampleParams,
    "voxels": VoxelParams,
    "profile": ProfileParams,
    "tile": TileParams,
    "label": LabelParams,
    "ground": GroundParams,
    "ground_auto": GroundAutoParams,
    "ground_search": GroundSearchParams,
    "terrain": TerrainParams,
    "contours": ContourParams,
    "water": WaterParams,
    "breaklines": ShapeFileParams,
    "features": FeaturesParams,
    "radiometry": RadiometryParams,
    "train": TrainParams,
    "select": SelectParams,
    "thin": ThinParams,
    "compare": CompareParams,
    "papers": PapersSection,
    "street": StreetParams,
    "street_scene": StreetSceneParams,
    "classify": ClassifyParams,
    "quality": QualityParams,
    "assess": AssessParams,
    "publish": PublishParams,
    "vectors": VectorParams,
    "suggest": SuggestParams,
    "adapt": AdaptParams,
    "view": ViewParams,
}


@dataclass(frozen=True)
class Config:
    """A whole, checked configuration and the file it came from.

    `raw`: as it was written, for reports; without the section `schedule`, which changes no result and may hold secrets.
    """

    path: Path
    raw: Mapping[str, Any]
    survey: SurveySection
    areas: AreasSection
    run: RunSection
    store: StoreParams
    plan: PlanSection
    seams: SeamsSection
    schedule: ScheduleSection
    simulate: SimulateParams | None
    read: ReadParams
    pulse: PulseParams
    decompose: DecomposeParams
    bathymetry: BathymetryParams
    plausibility: PlausibilityParams
    stack: StackParams
    samples: SampleParams
    voxels: VoxelParams
    profile: ProfileParams
    tile: TileParams
    label: LabelParams
    ground: GroundParams
    ground_auto: GroundAutoParams
    ground_search: GroundSearchParams
    terrain: TerrainParams
    contours: ContourParams
    water: WaterParams
    breaklines: ShapeFileParams
    features: FeaturesParams
    radiometry: RadiometryParams
    train: TrainParams
    select: SelectParams
    thin: ThinParams
    compare: CompareParams
    papers: PapersSection
    street: StreetParams
    street_scene: StreetSceneParams
    classify: ClassifyParams
    quality: QualityParams
    assess: AssessParams
    publish: PublishParams
    vectors: VectorParams
    suggest: SuggestParams
    adapt: AdaptParams
    view: ViewParams

    @property
    def classes(self) -> tuple[ClassDef, ...]:
        """The survey's classes, in its order, as they are learned and judged: without `legacy_code`."""
        return tuple(replace(c, legacy_code=None) for c in self.written_classes)

    @property
    def written_classes(self) -> tuple[ClassDef, ...]:
        """Those of `classes` with their `legacy_code`, as a model's card has them."""
        return tuple(ClassDef(**c.model_dump()) for c in self.survey.classes)

    @property
    def features_asked(self) -> tuple[str, ...]:
        """Names of the columns that the classifier decides by."""
        asked = self.survey.features
        if not isinstance(asked, str):
            return listed_once(asked, f"{self.path}: survey.features")
        return feature_set(asked, self.path.parent, f"{self.path}: survey.features").features

    @property
    def selection(self) -> Selection | None:
        """How the features were chosen, where their set's file tells; it is read at a run's end, and may be gone."""
        asked = self.survey.features
        try:
            return feature_set(asked, self.path.parent).selection if isinstance(asked, str) else None
        except ConfigError:
            return None

    @property
    def simulated(self) -> bool:
        """The survey has no files of its own: it is simulated into the run directory."""
        return self.survey.simulated and self.survey.directory is None
