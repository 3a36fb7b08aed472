"""What the names of features ask for: measures and neighbourhoods, columns that are read, and how far around."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass

from fwclass.columns import COLUMNS
from fwclass.columns import FEATURES as DECLARED
from fwclass.errors import ConfigError
from fwclass.features.params import FeaturesParams
from fwclass.schema import PLACE, Scale, split_known, split_name

MAX_NEAREST = 500
"""Echoes of the largest neighbourhood of nearest echoes. The papers take 10 to 100; the time of a search grows with k
and faster, and 500 echoes lie within 4 to 11 m at 1 to 10 echoes per square metre, which spheres describe better."""

ORIENTED = "oriented_inclination"
"""The feature whose sides spread beyond its sphere."""

MAX_REACH = 100.0
"""m, no feature reaches further: larger ones describe a district, not a point's surroundings."""

NO_FEATURE = ("strip", "pulse", "source_class", "origin", "gps_time", "x", "y", "z")
"""Columns that no forest may decide by: they name an echo, its place, or the class that it came with."""

_BASES = frozenset(c.name for c in DECLARED)
_END = re.compile(r"_(?P<kind>[rckg])(?P<size>\d+)$")
_LIKE = {"r": "r100", "c": "c200", "k": "k20", "g": "g100", "o": "opt"}
"""A neighbourhood of every kind, to show how names end."""
_NUMBERS = ("echo_number", "number_of_echoes")
_READS = {
    **dict.fromkeys(("single_share", "first_share", "intermediate_share", "last_share", "egi", "ebi", "evi"), _NUMBERS),
    **dict.fromkeys(("amplitude_mean", "amplitude_std"), ("amplitude",)),
    **dict.fromkeys(("width_mean", "width_std"), ("width",)),
    **dict.fromkeys(("intensity_mean", "intensity_std"), ("intensity",)),
    "pulse_intensity_variance": ("strip", "pulse", "gps_time", *_NUMBERS, "intensity"),
    "pulse_amplitude_variance": ("strip", "pulse", "gps_time", *_NUMBERS, "amplitude"),
}
"""What a feature reads besides the echoes' places."""


def is_feature(name: str) -> bool:
    """Whether `name` is a feature of a neighbourhood, a cell or a pulse, which this room computes."""
    parts = split_known(name)
    return parts is not None and parts[0] in _BASES


def check_scale(name: str, where: object) -> None:
    """`ConfigError` for a feature's name whose size is no size, or whose neighbourhood has too many echoes."""
    end = _END.search(name)
    if end is None or name[: end.start()] not in _BASES:
        return
    kind, digits = end["kind"], end["size"]
    if not is_feature(name) and kind in COLUMNS[name[: end.start()]].scales:
        zero = set(digits) <= {"0"}
        raise ConfigError(
            f"{name!r} is not a feature: the size must be positive"
            if zero
            else f"{name!r} is not a feature: its size is not a size",
            where=where,
            expected=f"echoes, 1 to {MAX_NEAREST}" if kind == "k" else "centimetres, 1 to 10000, without leading 0",
            got=digits,
        )
    if kind == "k" and int(digits) > MAX_NEAREST:
        raise ConfigError(
            f"{name!r} asks for too many neighbours",
            where=where,
            expected=f"at most {MAX_NEAREST} nearest echoes",
            got=digits,
            do="take fewer, or a sphere: planarity_r300 is one of 3 m",
        )


def meant(name: str, others: Iterable[str] = ()) -> str:
    """``did you mean …?`` for a word that is no feature and none of `others`, or ""."""
    end = _END.search(name)
    base = name[: end.start()] if end else re.sub(r"_opt$", "", name)
    close = difflib.get_close_matches(base, sorted({*_BASES, *others}), n=1)
    if not close:
        return ""
    whole = close[0] + name[len(base) :]
    if not is_feature(whole) and close[0] in _BASES and not is_feature(close[0]):  # a base without its neighbourhood
        whole = f"{close[0]}_{_LIKE[COLUMNS[close[0]].scales[0]]}"
    return f"did you mean {whole if is_feature(whole) else close[0]!r}?"


@dataclass(frozen=True)
class FeatureRequest:
    """What is to be computed for a list of feature names.

    Attributes
    ----------
    names : the features, in order, each once.
    scales : (scale, bases taken over it), in order of first appearance.
    plain : features without a scale.
    """

    names: tuple[str, ...]
    scales: tuple[tuple[Scale, tuple[str, ...]], ...]
    plain: tuple[str, ...]

    @classmethod
    def of(cls, names: Iterable[str]) -> FeatureRequest:
        """`KeyError` for a name that is no feature."""
        once = tuple(dict.fromkeys(names))
        scales: dict[Scale, list[str]] = {}
        plain = []
        for name in once:
            base, scale = split_name(name)
            if base not in _BASES:
                raise KeyError(f"{name!r} is no feature of a neighbourhood")
            if scale is None:
                plain.append(name)
            else:
                scales.setdefault(scale, []).append(base)
        return cls(once, tuple((s, tuple(bases)) for s, bases in scales.items()), tuple(plain))

    def of_kind(self, kinds: str) -> dict[Scale, tuple[str, ...]]:
        """Bases by scale, of the given kinds of neighbourhood (letters of `columns.SCALES`)."""
        return {scale: bases for scale, bases in self.scales if scale.kind in kinds}

    @property
    def bases(self) -> frozenset[str]:
        """Names of the measures asked for, without their neighbourhoods."""
        return frozenset((*self.plain, *(b for _, bases in self.scales for b in bases)))

    @property
    def reads(self) -> tuple[str, ...]:
        """Columns that they are computed from."""
        more = (name for base in sorted(self.bases) for name in _READS.get(base, ()))
        return tuple(dict.fromkeys((*PLACE, *more)))

    def columns(self, params: FeaturesParams) -> tuple[str, ...]:
        """As `reads`, and what tells which echoes are no neighbours."""
        return self.reads if params.noise_counts else (*self.reads, "noise")

    def reach(self, params: FeaturesParams) -> float:
        """Distance around an echo that they are computed from, and the normals too [m]."""
        reach = [params.normal_radius]
        for scale, bases in self.scales:
            if scale.kind == "k":
                reach.append(params.nearest_reach)
            elif scale.kind == "o":
                reach.append(max(params.optimal_radii))
            else:
                turns = params.orientation_rounds if ORIENTED in bases else 0
                reach.append(scale.metres * (1 + turns))
        if "zc" in self.plain:
            reach += [params.cell_x, params.cell_y]
        if "optimal_radius" in self.plain:
            reach.append(max(params.optimal_radii))
        if any(name.startswith("pulse_") for name in self.plain):
            reach.append(params.pulse_reach)
        return float(max(reach))

    def halo(self, params: FeaturesParams) -> float:
        """What a tile reads around it [m]: a dense column (`dense_column`) is always read completely, also those of
        neighbours."""
        return self.reach(params) + 2 * params.dense_column
