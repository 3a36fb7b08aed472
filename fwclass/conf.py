"""Configuration: `conf/base.yaml` holds every number once, a survey's file changes what it needs.

Everything is checked before anything runs; an unknown key is an error that names the nearest known one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fwclass.assess.stage import AssessParams
from fwclass.decompose.params import DecomposeParams
from fwclass.decompose.pulse_sample import PulseParams
from fwclass.errors import ConfigError, nearest
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

_SIZE_LIMIT = 1 << 20


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


_PARAMS: dict[str, type[BaseModel]] = {
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


def conf_directory() -> Path:
    """The `conf` directory: beside the package in a checkout, inside it when installed."""
    here = Path(__file__).resolve().parent
    installed = here / "_conf"
    return installed if installed.is_dir() else here.parent / "conf"


def find(name: str | Path) -> Path:
    """A configuration by path, or by the name of one that comes with fwclass."""
    path = Path(name)
    if path.is_file():
        return path
    shipped = conf_directory() / "surveys"
    by_name = shipped / f"{path.stem}.yaml"
    if path.parent in (Path(), Path("conf/surveys")) and by_name.is_file():
        return by_name
    known = [p.stem for p in shipped.glob("*.yaml")]
    raise ConfigError(
        "no such configuration",
        where=path,
        expected="a YAML file, or the name of one that comes with fwclass",
        got=nearest(path.stem, known),
        do="give its path",
    )


class _Loader(yaml.SafeLoader):
    """Safe loading that refuses a key given twice (plain YAML keeps the last one silently)."""


def _mapping(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    keys = [loader.construct_object(k, deep=True) for k, _ in node.value]
    twice = {str(k) for k in keys if keys.count(k) > 1}
    if twice:
        raise yaml.constructor.ConstructorError(
            None, None, f"key given twice: {', '.join(sorted(twice))}", node.start_mark
        )
    return {k: loader.construct_object(v, deep=True) for k, (_, v) in zip(keys, node.value, strict=True)}


_Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping)


def _read(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > _SIZE_LIMIT:
            raise ConfigError("a configuration this large is not one", where=path, got=f"{path.stat().st_size} bytes")
        value = yaml.load(path.read_text(encoding="utf-8"), Loader=_Loader)  # noqa: S506 - a SafeLoader
    except (OSError, yaml.YAMLError, UnicodeDecodeError) as fault:
        told = " ".join(str(fault).split()).replace('"<unicode string>"', path.name)
        tabs = "indent with spaces: YAML knows no tabs" if "\\t" in told else "mend the YAML at the place named"
        raise ConfigError("a configuration cannot be read", where=path, got=told, do=tabs) from fault
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise ConfigError("a configuration is a mapping of sections", where=path, got=type(value).__name__)
    return value


def _merged(base: Any, change: Any) -> Any:
    """`change` laid over `base`: mappings merge, everything else is replaced."""
    if isinstance(base, dict) and isinstance(change, dict):
        return {k: _merged(base.get(k), change[k]) if k in change else base[k] for k in {**base, **change}}
    return change


def _setting(text: str) -> dict[str, Any]:
    """``ground.slope=0.2`` as a nested mapping."""
    path, equals, value = text.partition("=")
    names = path.strip().split(".")
    if not equals or len(names) < 2 or not all(names):
        raise ConfigError(
            "--set wants section.key=value", where="--set", expected="for example ground.slope=0.2", got=text
        )
    try:
        result: Any = yaml.safe_load(value)
    except yaml.YAMLError as fault:
        raise ConfigError("the value of --set cannot be read", where=f"--set {text}", got=fault) from fault
    for name in reversed(names):
        result = {name: result}
    return dict(result)


def load(name: str | Path, settings: tuple[str, ...] = ()) -> Config:
    """The configuration `name` over `conf/base.yaml`, with `settings` (``section.key=value``) over both.

    Where one of them names a ``ground.preset``, that lies between `conf/base.yaml` and the others.
    """
    path = find(name)
    change = _read(path)
    for text in settings:
        change = _merged(change, _setting(text))
    raw = _laid(change)
    return build(path, raw, f"{path} with --set {' --set '.join(settings)}" if settings else str(path))


def section(name: str, settings: tuple[str, ...] = (), change: Mapping[str, Any] | None = None) -> Any:
    """The params of one section as `conf/base.yaml` has them (single-file commands).

    `settings` (``section.key=value``) go before the base, and `change` (nested mappings by section) before both.
    """
    path = conf_directory() / "base.yaml"
    changes: dict[str, Any] = {}
    for text in settings:
        changes = _merged(changes, _setting(text))
    raw = _laid(_merged(changes, dict(change or {})))
    where = f"{path} with --set {' --set '.join(settings)}" if settings else path
    return _build(name, raw.get(name), where)


def _laid(change: dict[str, Any]) -> dict[str, Any]:
    """`change` over `conf/base.yaml`, with the ground preset that it names between them."""
    base = _read(conf_directory() / "base.yaml")
    ground = change.get("ground")
    name = ground.get("preset") if isinstance(ground, dict) else None
    if name is not None:
        own = {key: value for key, value in preset(str(name)).items() if key != "about"}
        base = _merged(base, {"ground": own})
    return dict(_merged(base, change))


def presets() -> dict[str, dict[str, Any]]:
    """What every preset of the ground filters changes, by name; ``about`` says what it is for."""
    return _read(conf_directory() / "presets" / "ground.yaml")


def preset(name: str) -> dict[str, Any]:
    """One of `presets`."""
    known = presets()
    if name not in known:
        raise ConfigError(
            "no such preset", where="ground.preset", expected=", ".join(known), got=name, do=nearest(name, known)
        )
    return known[name]


def build(path: Path, raw: dict[str, Any], where: str = "") -> Config:
    """A checked configuration; `where` names its origin in messages."""
    where = where or str(path)
    for name in raw:
        if name not in _PARAMS:
            raise ConfigError(f"unknown section {name!r}", where=where, got=name, do=nearest(str(name), _PARAMS))
    values = {n: _build(n, raw.get(n), where) for n in _PARAMS if n != "simulate"}
    simulated = values["survey"].directory is None
    simulate = _build("simulate", raw.get("simulate"), where) if simulated else None
    config = Config(path=path, raw=raw, simulate=simulate, **values)
    _check(config)
    return config


def checked(name: str, value: Any, where: object) -> Any:
    """The params of a section from plain data; `where` names its origin in messages."""
    return _build(name, value, where)


def _build(name: str, value: Any, path: object) -> Any:
    if value is None:
        raise ConfigError(f"section {name!r} is missing", where=path, do=f"add `{name}:`")
    model = _PARAMS[name]
    if name == "ground" and isinstance(value, dict):
        value = {key: v for key, v in value.items() if key != "preset"}  # laid under the other keys already
    try:
        return model.model_validate(value)
    except ValidationError as fault:
        raise ConfigError(
            f"section {name!r} is wrong",
            where=path,
            got="; ".join(_explain(name, model, e) for e in fault.errors()[:5]),
        ) from fault


def _explain(name: str, model: type[BaseModel], error: Any) -> str:
    key = ".".join([name, *(str(p) for p in error["loc"])])
    if error["type"] == "extra_forbidden":
        fields = model.model_fields if len(error["loc"]) == 1 else {}
        return f"unknown key {key} ({nearest(str(error['loc'][-1]), fields)})" if fields else f"unknown key {key}"
    if error["type"] == "missing":
        return f"{key} is missing"
    if error["type"] == "value_error" and isinstance(error["input"], Mapping):
        return f"{key}: {error['msg'].removeprefix('Value error, ')}"  # several keys that do not fit one another
    wanted = _WANTED.get(error["type"].split("_")[0], error["msg"])
    return f"{key}: {wanted} (got {str(error['input'])[:80]!r})"


_WANTED = {
    "tuple": "a list is wanted, as in [a, b]",
    "model": "keys with values are wanted, as in `key: value`",
    "dict": "keys with values are wanted, as in `key: value`",
    "string": "a text is wanted; put it in quotes if YAML takes it for something else",
    "float": "a number is wanted",
    "int": "a whole number is wanted",
    "bool": "true or false is wanted",
}
"""What to say for pydantic's kinds of error."""


def _check(config: Config) -> None:
    """What one section cannot see alone."""
    where = config.path
    names = [c.name for c in config.survey.classes]
    used = [code for c in config.survey.classes for code in c.codes]
    codes = [c.code for c in config.survey.classes]
    groups: tuple[tuple[str, list[Any]], ...] = (("name", names), ("code", codes), ("reference code", used))
    for what, values in groups:
        twice = {v for v in values if values.count(v) > 1}
        if twice:
            raise ConfigError(f"a class {what} is given twice", where=f"{where}: survey.classes", got=sorted(twice))
    if len(names) < 2:
        raise ConfigError("at least two classes are needed", where=f"{where}: survey.classes", got=names or "none")
    if not all(0 < c <= 255 for c in codes + used):
        raise ConfigError("class codes lie in 1 to 255", where=f"{where}: survey.classes", got=codes + used)
    for kind in ("train", "test"):
        for box in getattr(config.areas, kind):
            if not all(map(math.isfinite, box)) or box[0] >= box[2] or box[1] >= box[3]:
                raise ConfigError(
                    "an area is [xmin, ymin, xmax, ymax] with min < max",
                    where=f"{where}: areas.{kind}",
                    got=box,
                )
    if config.survey.model is None:
        if config.survey.reference.kind == "none":
            raise ConfigError(
                "nothing to train on",
                where=f"{where}: survey.reference",
                do="name a reference (source or cloud), or a trained model as survey.model",
            )
        if not config.areas.train:
            raise ConfigError(
                "no training area",
                where=f"{where}: areas.train",
                do="list at least one box [xmin, ymin, xmax, ymax]",
            )
