"""Parameters of radiometry; the numbers stand in `conf/base.yaml`."""

from __future__ import annotations

import math

from pydantic import Field, field_validator, model_validator

from fwclass.params import Params

RADIOMETRIC = ("range", "incidence", "cross_section", "backscatter", "reflectance", "radiometry_flags")
"""Columns that the radiometry gives to echoes."""


class TargetParams(Params):
    """A surface of known reflectance.

    Attributes
    ----------
    polygon : its outline in the survey's CRS [m], three or more corners; the last need not repeat the first.
    reflectance : its diffuse reflectance at the laser's wavelength, a fraction.
    """

    polygon: tuple[tuple[float, float], ...] = Field(min_length=3)
    reflectance: float = Field(gt=0.0, le=1.0)

    @field_validator("polygon")
    @classmethod
    def _encloses(cls, polygon: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        x0, y0 = polygon[0]
        turned = zip(polygon, polygon[1:] + polygon[:1], strict=True)
        if math.isclose(sum((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0) for (x1, y1), (x2, y2) in turned), 0.0):
            raise ValueError("the polygon encloses no area")
        return polygon


class OverlapParams(Params):
    """How strips are compared where they overlap.

    Attributes
    ----------
    cell : edge of the cells whose echoes are compared [m].
    least_echoes : a cell counts for a strip with at least so many usable echoes of it.
    max_spread : standard deviation of ln γ within a cell and strip above which the surface is taken for a mixture.
    max_incidence : echoes beyond this are not used [deg], here and on the target.
    least_cells : two strips are compared if they share at least so many cells.
    """

    cell: float = Field(ge=0.01, le=10_000)
    least_echoes: int = Field(ge=2)
    max_spread: float = Field(gt=0.0)
    max_incidence: float = Field(gt=0.0, lt=90.0)
    least_cells: int = Field(ge=5)


class RadiometrySoundParams(Params):
    """What a sound survey shows of its trajectory and calibration; beyond it commands end with exit code 4.

    Attributes
    ----------
    max_without_range : share of a strip's echoes without a range. max_astray : share that no scanner at the trajectory
    would see. displaced : between the trajectory and where the beams come from [m]. max_altitude_ratio : of the
        flying heights by `platform_altitude` and by the beams.
    brightest, darkest : reflectances [dB] of no surface; max_impossible : share of them.
    max_residual : of ln gain, between strips, or of the target in several. max_target_spread : standard deviation of
    ln backscatter on the target.
    """

    max_without_range: float = Field(ge=0.0, le=1.0)
    max_astray: float = Field(ge=0.0, le=1.0)
    displaced: float = Field(gt=0.0, le=100_000.0)
    max_altitude_ratio: float = Field(gt=1.0, le=1000.0)
    brightest: float = Field(ge=-1000.0, le=1000.0)
    darkest: float = Field(ge=-1000.0, le=1000.0)
    max_impossible: float = Field(ge=0.0, le=1.0)
    max_residual: float = Field(gt=0.0, le=100.0)
    max_target_spread: float = Field(gt=0.0, le=100.0)


class RadiometryParams(Params):
    """Parameters of range, cross-section and backscatter.

    Attributes
    ----------
    platform_altitude : height of the sensor in the survey's height system [m], for echoes whose range neither the
        source nor a trajectory tells; None: no range for these.
    max_time_gap : no position between two fixes of the trajectory further apart than this [s].
    max_incidence : γ takes incidence angles above this for this [deg].
    grazing : beams meet no surface at more than this [deg]: its neighbours lie in one plane with the beam, as those of
        one scan line do, and their normal is none.
    calibration : C_cal [m⁻² DN⁻¹ ns⁻¹]; None: from `target`, or 1 and flagged where there is none.
    extinction : of the air, one way [dB/km]; η of the formulas follows from it.
    divergence : full angle of the beam [mrad], for its cross-section A_i.
    balance : bring the strips to one gain by their overlap.
    target : surface that gives C_cal, or None.
    overlap : how strips are compared.
    sound : what is told, and refused, of the outcome.
    """

    platform_altitude: float | None
    max_time_gap: float = Field(gt=0.0)
    max_incidence: float = Field(gt=0.0, lt=90.0)
    grazing: float = Field(gt=0.0, le=90.0)
    calibration: float | None = Field(gt=0.0)
    extinction: float = Field(ge=0.0, le=1000.0)
    divergence: float = Field(gt=0.0, le=1000.0)
    balance: bool
    target: TargetParams | None
    overlap: OverlapParams
    sound: RadiometrySoundParams

    @property
    def calibrates(self) -> bool:
        """Something gives C_cal."""
        return self.calibration is not None or self.target is not None

    @model_validator(mode="after")
    def _one_constant(self) -> RadiometryParams:
        if self.calibration is not None and self.target is not None:
            raise ValueError("calibration and target both give C_cal: set one of them to null")
        return self
