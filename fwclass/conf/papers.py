"""What the papers print, one file each in `conf/papers`: figures to set ours beside."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from fwclass.conf.files import conf_directory, read
from fwclass.errors import ConfigError


class _Printed(BaseModel):
    """Unknown keys are refused: in a YAML flow mapping an unquoted comma cuts a text in two, and makes a key of one."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class _Claim(_Printed):
    claim: str
    figure: str
    where: str


class _Paper(_Printed):
    citation: str
    doi: str
    data: str
    classes: dict[str, str]
    notes: list[str]
    claims: dict[str, _Claim]


class _Range(_Printed):
    text: str
    low: float | None = None
    high: float | None = None


class _Order(_Printed):
    order: list[str]
    accuracy: list[float]
    dropped: list[str]


class _Table(_Printed):
    overall: float
    confusion: list[list[int]]
    producers: list[float]


class _Seconds(_Printed):
    svm: float
    selection: float
    forest: float


class _Fan(_Paper):
    distribution: dict[str, dict[str, _Range]]
    selection: _Order
    splits: dict[str, _Table]
    svm: _Table
    seconds: _Seconds


class _Strategy(_Printed):
    title: str
    overall: float
    kappa: float
    omission: dict[str, float]
    commission: dict[str, float]
    train: float
    test: float


class _Samples(_Printed):
    train: int
    test: int


class _Selection(_Printed):
    candidates: int
    chosen: int
    accuracy: float
    folds: int
    least: int


class _Thinning(_Printed):
    rate: float


class _Xiong(_Paper):
    strategies: dict[str, _Strategy]
    samples: _Samples
    selection: _Selection
    radii: dict[str, list[str]]
    groups: dict[str, list[str]]
    thinning: _Thinning


class _Two(_Printed):
    building: float
    vegetation: float


class _Combination(_Two):
    artificial: float


class _Algorithm(_Combination):
    overall: float
    ground: float
    seconds: float


class _Ranked(_Printed):
    kept: list[str]
    dropped: list[str]


class _Shi(_Paper):
    combinations: dict[str, _Combination]
    boundary: dict[str, _Two]
    algorithms: dict[str, _Algorithm]
    fscore: _Ranked


class _Single(_Printed):
    radius: float
    error: float
    best: float
    order: list[str]


class _Li(_Paper):
    points: dict[str, int]
    share: float
    radii: list[float]
    bounds: dict[str, float]
    single: _Single


class _He(_Paper):
    families: list[str]
    optima: dict[str, list[float]]
    gains: dict[str, float]


_MODELS: dict[str, type[_Paper]] = {"fan2013": _Fan, "shi2019": _Shi, "xiong2018": _Xiong, "li2018": _Li, "he2023": _He}


def paper(name: str) -> dict[str, Any]:
    """The figures of a paper, plain data; see its file.

    `ConfigError`: a key that the file must not have or lacks, or a value of another kind.
    """
    path = conf_directory() / "papers" / f"{name}.yaml"
    return check_printed(name, read(path), path)


def check_printed(name: str, printed: dict[str, Any], where: object) -> dict[str, Any]:
    """`printed` itself, once it has been held against what the file of paper `name` holds."""
    try:
        _MODELS[name].model_validate(printed)
    except ValidationError as fault:
        faults = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in fault.errors()[:5])
        raise ConfigError(
            "the figures of a paper are wrong",
            where=where,
            got=faults,
            do="mend the entry; in {…} a text with a comma needs quotes",
        ) from fault
    return printed
