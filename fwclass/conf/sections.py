"""The sections of a configuration that no room has: what the survey is, where it is learned, how it runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from fwclass.classes import MOST_LETTERS
from fwclass.conf.sets import MOST_FEATURES
from fwclass.errors import visible
from fwclass.grid import Box
from fwclass.params import Params

MOST_CODES = 255
"""Codes of classes that there are: 1 to 255."""

Pattern = Annotated[str, Field(max_length=1000)]
"""Of names of files; it takes time in proportion to the square of its brackets that stay open."""


class Section(Params):
    """Keys of a configuration that are no room's parameters; some have defaults."""


class ClassSection(Section):
    """One class: its name, the code it is delivered as, the reference codes that count as it (its own, unless given).

    `legacy_code` (0 to 31) is written where a source strip has a point format (0-5) that cannot hold `code`.
    """

    name: str = Field(min_length=1, max_length=MOST_LETTERS)
    code: int
    codes: tuple[int, ...] = Field(max_length=MOST_CODES)
    legacy_code: int | None = None

    @model_validator(mode="before")
    @classmethod
    def _own_code(cls, value: Any) -> Any:
        """A class that names no codes of the reference counts its own."""
        return {"codes": [value["code"]], **value} if isinstance(value, dict) and "code" in value else value

    @field_validator("name")
    @classmethod
    def _shows(cls, name: str) -> str:
        if visible(name) != name:
            raise ValueError("a class name has no characters that cannot be seen")
        if not name.strip():
            raise ValueError("a class name has letters")
        return name


class ReferenceSection(Section):
    """Where reference classes come from.

    `source`: the files' own classes; `cloud`: the nearest point of other `files`; `polygons`: files of polygons
    with a class `field`; `echoes`: Parquet files of codes by strip, pulse and echo number (in the column `field`;
    `class` unless given); `corrections`: nothing but these; `none`. Only of polygons: `values` says what the
    field's values mean (a reference code, the name of a class, or null for what labels nothing), `layer` which one
    where a file has several, `crs` what system they are in where the file names none or a wrong one. `corrections`:
    a Parquet file of delivered codes by echo that count more than any of these; null:
    ``labels/corrections.parquet`` of the run directory, where there is one; false: none.
    """

    kind: Literal["source", "cloud", "polygons", "echoes", "corrections", "none"]
    files: tuple[Pattern, ...] = ()
    field: str | None = None
    values: dict[str | int, str | int | None] = Field(default={})
    layer: str | None = None
    crs: str | None = None
    corrections: str | Literal[False] | None = None

    @model_validator(mode="after")
    def _fit(self) -> ReferenceSection:
        if self.kind == "none" and self.corrections:
            raise ValueError("`corrections` mend labels, and kind none has none: give them as `files` of kind echoes")
        if self.kind == "corrections" and (self.files or self.corrections is False):
            raise ValueError("kind corrections is the file `corrections` alone: no `files`, and not false")
        if self.kind in ("cloud", "polygons", "echoes") and not self.files:
            raise ValueError(f"kind {self.kind} needs `files`, relative to survey.directory")
        if self.kind == "polygons" and self.field is None:
            raise ValueError("kind polygons needs `field`, which holds the class (`fwclass info FILE` lists them)")
        alien = [n for n in ("values", "layer", "crs") if getattr(self, n) and self.kind != "polygons"]
        alien += ["field"] if self.field and self.kind not in ("polygons", "echoes") else []
        if alien:
            raise ValueError(f"`{alien[0]}` belongs to kind polygons{' or echoes' if alien[0] == 'field' else ''}")
        return self


class SurveySection(Section):
    """What is classified.

    `directory` is relative to the survey's file; null: beside it, or, of a `simulated` survey, in the run
    directory, into which it is simulated; ``data:NAME`` lies below the directory that the environment variable
    FWCLASS_DATA names, and `origin` says where its files can be had. `exclude`: patterns of files that `sources`
    match and that are left out. `echoes` of files with waveforms are found in these (``waveforms``), or the files'
    own ``returns``, their waveforms left aside; ``auto``: returns for a workflow that they are enough for, where
    every file has some and the run does not hold echoes of waveforms. `crs`, if given, is used for all files,
    whatever they name; `none` goes without. `features`: what the classifier decides by, a list of columns or the
    name or file of a feature set. `model`: directory of a trained model to use instead of training, or null.
    `base_model`: of one that keeps rows that it has learned from; they are learned from beside the survey's labels,
    by its features and, unless named, its classes.
    """

    name: str = Field(pattern=r"^\w[\w .-]*$", max_length=100)
    directory: str | None
    origin: str | None
    simulated: bool
    echoes: Literal["auto", "waveforms", "returns"]
    sources: tuple[Pattern, ...] = Field(min_length=1)
    exclude: tuple[Pattern, ...]
    crs: str | None
    reference: ReferenceSection
    trajectory: TrajectorySection
    features: str | tuple[str, ...] = Field(min_length=1, max_length=MOST_FEATURES)
    model: str | None
    base_model: str | None
    classes: tuple[ClassSection, ...] = Field(max_length=MOST_CODES)


class TrajectorySection(Section):
    """Where the sensor flew: files (text or SBET), and the height of the survey's zero above the ellipsoid [m], taken
    from their heights."""

    files: tuple[Pattern, ...]
    undulation: float


EVERYWHERE = (-1e8, -1e8, 1e8, 1e8)
"""m, the box that ``areas.train: all`` stands for: no projected coordinate lies beyond it."""


class AreaFilesSection(Section):
    """Areas by files: where `files` (patterns) of the survey lie, by their bounds, or what `polygons`, one file, cover.

    Of polygons only: `layer` of a file with several, `crs` where the file names no system or a wrong one.
    """

    files: tuple[Pattern, ...] = ()
    polygons: str | None = None
    layer: str | None = None
    crs: str | None = None

    @model_validator(mode="after")
    def _one(self) -> AreaFilesSection:
        if bool(self.files) == (self.polygons is not None):
            raise ValueError("either `files` or `polygons` names an area")
        if self.polygons is None and (self.layer or self.crs):
            raise ValueError("`layer` and `crs` belong to `polygons`")
        return self


class AreasSection(Section):
    """Where to train and where to test, boxes [xmin, ymin, xmax, ymax) [m]; `train` may be ``all``.

    `test` empty: all that lies further than `gap` from every training box. `gap` also keeps listed test boxes apart.
    Where either is a mapping, it names files or polygons: `train_by`, `test_by`, until these are looked up.
    """

    train: tuple[tuple[float, float, float, float], ...]
    test: tuple[tuple[float, float, float, float], ...]
    gap: float = Field(ge=0, le=1_000_000)
    train_by: AreaFilesSection | None = None
    test_by: AreaFilesSection | None = None

    @model_validator(mode="before")
    @classmethod
    def _by_files(cls, value: Any) -> Any:
        if not isinstance(value, Mapping):
            return value
        by = {f"{k}_by": value[k] for k in ("train", "test") if isinstance(value.get(k), Mapping)}
        return {**value, **by, **{name.removesuffix("_by"): () for name in by}}

    @field_validator("train", mode="before")
    @classmethod
    def _all(cls, train: Any) -> Any:
        return (EVERYWHERE,) if train == "all" else train

    @property
    def trains_everywhere(self) -> bool:
        """Whether every labelled echo trains, so that none is left to test on."""
        return self.train == (EVERYWHERE,)

    def boxes(self, name: Literal["train", "test"]) -> tuple[Box, ...]:
        """Training or test areas."""
        return tuple(Box(*b) for b in getattr(self, name))

    def shown(self, box: Box) -> dict[str, list[list[float]]]:
        """Bounds of the areas by kind, for maps and layers of a survey that lies in `box`."""
        train = (box,) if self.trains_everywhere else self.boxes("train")
        return {"train": [list(b.bounds) for b in train], "test": [list(b.bounds) for b in self.boxes("test")]}


class RunSection(Section):
    """Where it runs; never changes a result.

    `seam_check_echoes`: so many echoes are filtered once more in windows that lie elsewhere, to tell in the
    report what the seams between blocks changed; 0 leaves the check out. `keep_generations`: whole deliveries that
    stay.
    `keep_intermediate`: parts stay after a whole delivery; without them every run makes all anew. ``lean``: the bulky
    ones that are made quickly go (`Stage.bulky`), and are made anew where one that reads them has to be.
    `window`: parts that the scheduler knows at a time. `retries`: times that a part whose worker was lost is tried
    again among others, and then alone, in `split` × `split` pieces of a tile where the stage can. `part_hours`: a
    part that takes longer has failed, and its worker is ended; the plain loop only says so. `accept_libraries`:
    parts that were made with other versions of libraries are done.
    """

    workers: int = Field(ge=0, le=10_000)
    worker_memory_gib: float = Field(gt=0, le=100_000)
    window: int = Field(ge=1, le=10_000_000)
    retries: int = Field(ge=0, le=100)
    part_hours: float = Field(gt=0, le=10_000)
    split: int = Field(ge=1, le=100)
    keep_generations: int = Field(ge=1, le=100_000)
    keep_intermediate: bool | Literal["lean"]
    seam_check_echoes: int = Field(ge=0, le=1_000_000_000)
    accept_libraries: bool


class SeamsSection(Section):
    """What `fwclass seams` computes once more; numbers stand in `conf/base.yaml`.

    Attributes
    ----------
    width : echoes as near as this to a border of tiles or of blocks [m].
    share : of the borders' length, and of the blocks.
    seed : draws them.
    tile : edge of the other tiles that blocks are read from, over that of the run's; not 1.
    listed : so many echoes of each stage that differ are listed.
    """

    width: float = Field(gt=0, le=10_000)
    share: float = Field(gt=0, le=1)
    seed: int = Field(ge=0)
    tile: float = Field(ge=0.1, lt=1)
    listed: int = Field(ge=0, le=1_000_000)


class PapersSection(Section):
    """How the papers' workflows judge their variants; numbers stand in `conf/base.yaml`.

    Attributes
    ----------
    test_echoes : drawn uniformly of all echoes, about; those that lie in the test areas judge every variant.
    seed : draws them.
    seeds : of the forests that are compared with and without waveform features.
    block : edge of the squares of the global grid that intervals draw as a whole [m].
    repeats : permutations of a feature and tree for the importance.
    more_classes : classes that a paper does not have: its variants neither train nor are scored on them.
    """

    test_echoes: int = Field(ge=1, le=1_000_000_000)
    seed: int = Field(ge=0, lt=2**63)
    seeds: tuple[Annotated[int, Field(ge=0, lt=2**63)], ...] = Field(min_length=1, max_length=100)
    block: float = Field(ge=0.1, le=100_000)
    repeats: int = Field(ge=1, le=1000)
    more_classes: tuple[ClassSection, ...]
