"""Features of neighbourhoods, declared once: name, formula, unit, source, and what they may be taken over.

N is the number of echoes of the neighbourhood, the echo itself included; l1 >= l2 >= l3 are the eigenvalues of the
covariance of its coordinates (divided by N) and s1, s2, s3 their shares of the sum; z_i are its heights.
"""

from __future__ import annotations

from typing import Any

from fwclass.columns.record import Column, measured_column, published_columns

XIONG, WEINMANN = "Xiong 2018", "Weinmann 2015"
PV = "Shi 2019, PV"
ALL = "rckgo"
SHAPE = "rko"


def _feature(name: str, unit: str, meaning: str, scales: str, source: str = "", **more: Any) -> Column:
    return measured_column(name, unit, meaning, scales=scales, source=source, **more)


def _share(name: str, meaning: str, scales: str = ALL, source: str = "", **more: Any) -> Column:
    return _feature(name, "", meaning, scales, source, low=0, high=1, **more)


_COLUMNS = (
    # places without a scale
    _feature("zc", "m", "z minus the lowest z of the 12 m x 10 m cell", "", "Fan 2013, 2.1", low=0),
    _feature("optimal_radius", "m", "the radius whose eigenentropy is lowest", "", WEINMANN, low=0),
    _feature("pulse_intensity_variance", "", "variance of the intensities of the pulse's echoes", "", PV, low=0),
    _feature("pulse_amplitude_variance", "DN2", "variance of the amplitudes of the pulse's echoes", "", PV, low=0),
    # how many
    _feature("count", "", "N", "rcgo", low=1),
    _feature("density", "1/m2", "N over the area of the circle or cell", "cg", low=0),
    _feature("reach", "m", "distance of the furthest of the nearest echoes", "k", low=0),
    _share(
        "echo_ratio", "echoes in the sphere / echoes in the vertical cylinder of its radius", "r", "Fan 2013, eq. 2"
    ),
    # heights
    _feature("height_range", "m", "max z_i - min z_i", ALL, XIONG, low=0),
    _feature("height_std", "m", "standard deviation of z_i", ALL, XIONG, low=0),
    _feature("height_variance", "m2", "variance of z_i", ALL, "Shi 2019, HV", low=0),
    _feature("height_skewness", "", "mean of ((z_i - mean) / std)^3; 0 where all z_i are equal", ALL, XIONG),
    _feature("height_kurtosis", "", "mean of ((z_i - mean) / std)^4; 0 where all z_i are equal", ALL, XIONG, low=0),
    _feature("height_above_mean", "m", "z - mean z_i", ALL),
    _feature("height_above_lowest", "m", "z - min z_i", ALL, low=0),
    _feature("height_below_highest", "m", "max z_i - z", ALL, low=0),
    *(
        _feature(f"height_above_p{p:02d}", "m", f"z - the {p}th percentile of z_i, nearest rank", "rck")
        for p in (5, 10, 25, 50, 75, 90, 95)
    ),
    # shape
    _share("eigenvalue_1", "s1 = l1 / (l1 + l2 + l3)", SHAPE, XIONG),
    _share("eigenvalue_2", "s2 = l2 / (l1 + l2 + l3)", SHAPE, XIONG),
    _share("eigenvalue_3", "s3 = l3 / (l1 + l2 + l3)", SHAPE, XIONG),
    _feature("eigenvalue_sum", "m2", "l1 + l2 + l3", SHAPE, WEINMANN, low=0),
    _share("linearity", "(l1 - l2) / l1", SHAPE, "West 2004"),
    _share("planarity", "(l2 - l3) / l1", SHAPE, "West 2004"),
    _share("sphericity", "l3 / l1", SHAPE, "West 2004"),
    _share("anisotropy", "(l1 - l3) / l1", SHAPE, "West 2004"),
    _feature("omnivariance", "m2", "(l1 l2 l3)^(1/3)", SHAPE, "Li 2018; West 2004", low=0),
    _feature("eigenentropy", "", "-(s1 ln s1 + s2 ln s2 + s3 ln s3)", SHAPE, WEINMANN, low=0),
    _share("surface_variation", "s3, the change of curvature", SHAPE, "Pauly 2003"),
    _share("verticality", "1 - |n_z| of the normal n", SHAPE, "Demantke 2012"),
    _feature(
        "inclination",
        "deg",
        "angle between local normal and vertical",
        SHAPE,
        "Fan 2013, A; Shi 2019, beta",
        low=0,
        high=90,
    ),
    _feature(
        "oriented_inclination",
        "deg",
        "angle between consistently oriented normal and vertical",
        "r",
        "Fan 2013, 2.2 (propagation)",
        low=0,
        high=180,
    ),
    _feature("roughness", "m", "distance of the echo from the fitted plane", SHAPE, XIONG, low=0),
    _feature("plane_range", "m", "extent of the neighbourhood along the normal", SHAPE, XIONG, low=0),
    _feature(
        "plane_std",
        "m",
        "sqrt(l3), root mean square distance from the fitted plane",
        SHAPE,
        "Xiong 2018; Shi 2019, R",
        low=0,
    ),
    # kinds of echoes; single + first of several + intermediate + last of several = 1
    _share("single_share", "single echoes / N"),
    _share("first_share", "first echoes of several / N"),
    _share("intermediate_share", "intermediate echoes / N"),
    _share("last_share", "last echoes of several / N"),
    _share("egi", "(single + last) / N", source="Xiong 2018, EGI"),
    _share("ebi", "(single + first) / N", source="Xiong 2018, EBI"),
    _share("evi", "(first + intermediate) / N", source="Xiong 2018, EVI"),
    # what the echoes measured
    _feature("amplitude_mean", "DN", "mean amplitude of the echoes that have one", ALL, low=0),
    _feature("amplitude_std", "DN", "standard deviation of amplitude", ALL, low=0),
    _feature("width_mean", "ns", "mean echo width of the echoes that have one", ALL, low=0),
    _feature("width_std", "ns", "standard deviation of echo width", ALL, low=0),
    _feature("intensity_mean", "", "mean intensity", ALL, "Xiong 2018, AI", low=0),
    _feature("intensity_std", "", "standard deviation of intensity", ALL, low=0),
)
_EXTRA_BYTES: dict[str, tuple[Any, ...]] = {
    "zc": ("zc", "above the lowest of its cell"),
    "echo_ratio": ("echo ratio", "echoes in sphere / in cylinder"),
    "inclination": ("inclination", "local normal to vertical"),
}
"""Of LAS: the name there, what is said of it, how it is stored."""

FEATURES = published_columns(_COLUMNS, _EXTRA_BYTES)
