"""Columns that are made of echoes: ground, heights, normals, radiometry, classes."""

from __future__ import annotations

from typing import Any

from fwclass.columns.record import PER_CODE, Column, measured_column, published_columns

_COLUMNS = (
    # ground
    Column("ground", "bool", "", "the ground filter took the echo for ground"),
    Column("noise", "bool", "", "the ground filter took the echo for no surface: far below its surroundings, or alone"),
    measured_column("height_above_ground", "m", "z minus the terrain model under the echo"),
    # thinning
    Column("sampled", "bool", "", "the classifier is asked about the echo; the others follow the nearest such one"),
    # the local surface, for radiometry
    measured_column("normal_x", "", "upward unit normal of the neighbourhood, east", low=-1, high=1),
    measured_column("normal_y", "", "upward unit normal of the neighbourhood, north", low=-1, high=1),
    measured_column("normal_z", "", "upward unit normal of the neighbourhood, up", low=0, high=1),
    # radiometry
    measured_column("range", "m", "distance from the sensor to the echo", low=0),
    measured_column("incidence", "deg", "angle between the beam and the local normal", low=0, high=90),
    measured_column(
        "cross_section",
        "m2",
        "backscatter cross-section sigma of the echo",
        low=0,
        source="Wagner 2006, eq. 9; Wagner 2008",
    ),
    measured_column(
        "backscatter",
        "",
        "backscatter coefficient gamma = sigma / (A_i cos(incidence)); relative where no target calibrates it",
        low=0,
        source="Fan 2013, eq. 3; Wagner 2008",
    ),
    measured_column(
        "reflectance",
        "dB",
        "10 log10 of the cross-section over that of a white matt surface that faces the beam",
        source="RIEGL extra byte `Reflectance`",
    ),
    Column(
        "radiometry_flags",
        "u1",
        "",
        "1 one of several echoes, 2 no range, 4 no normal, 8 incidence clipped, 16 saturated, 32 uncalibrated",
    ),
    # classes
    Column("reference", "u1", "", "reference class code; 0 is none"),
    Column("label_code", "u1", "", "reference class code that a label by echo gives; 0 says that the echo has none"),
    Column("coarse_class", "u1", "", "class code given by the first of two layers"),
    Column("coarse_confidence", "f4", "", "share of the class in the first of two layers", low=0, high=1),
    Column("coarse_entropy", "f4", "", "entropy of the shares in the first of two layers", low=0, high=1),
    Column("model_share", "u1", "", "share of a class before neighbours agree, in 255ths", scales=PER_CODE),
    Column("coarse_share", "u1", "", "share of a class by the first of two layers, in 255ths", scales=PER_CODE),
    Column(
        "fold_share",
        "u1",
        "",
        "as coarse_share, by a layer that has not learned from the square that the echo lies in",
        scales=PER_CODE,
    ),
    Column("boundary", "bool", "", "the echo lies where two classes meet, and the second of two layers answers"),
    Column("classification", "u1", "", "class code given by the model"),
    measured_column(
        "confidence", "", "share of the class: of the forest's votes, or the model's probability", low=0, high=1
    ),
    measured_column(
        "entropy", "", "entropy of the shares of all classes over ln(classes): 0 sure, 1 undecided", low=0, high=1
    ),
    measured_column(
        "probability",
        "",
        "share of a class: of the forest's votes, or the model's probability",
        low=0,
        high=1,
        scales=PER_CODE,
    ),
    # vectors
    Column("component", "u4", "", "number of what cells, or corners, belong to"),
    Column("cell_row", "i4", "", "row of the cell in the global raster, from its origin to the north"),
    Column("cell_column", "i4", "", "column of the cell in the global raster, from its origin to the east"),
    Column("cell_echoes", "u4", "", "echoes of the class in the cell"),
    Column("cell_rated", "u4", "", "those of them that have a confidence"),
    Column("cell_percent", "u4", "%", "sum of these confidences"),
    measured_column("cell_top", "m", "greatest height above ground of these echoes"),
    Column("ring", "u4", "", "number of the corner's ring: 0 the outline, others holes"),
    measured_column("object_height", "m", "height above ground"),
    measured_column("median_height", "m", "median height above ground"),
    Column("object_area", "f4", "m2", "area in plan"),
    Column("object_echoes", "u4", "", "echoes that it is made of"),
    Column("outline", "u1", "", "1 right-angled, 2 simplified, 3 the outline of the cells"),
)
_EXTRA_BYTES: dict[str, tuple[Any, ...]] = {
    "height_above_ground": ("HeightAboveGround", "above the terrain model", "i2", 0.01),
    "range": ("range", "from sensor to echo", "u4", 0.01),
    "incidence": ("incidence angle", "beam to local normal", "u1", 0.5),
    "cross_section": ("cross section", "backscatter cross-section"),
    "backscatter": ("backscatter", "coefficient, 4 x reflectance"),
    "reflectance": ("Reflectance", "over white facing the beam", "i2", 0.01),
    "radiometry_flags": ("radiometry flags", "bits, see docs/radiometry.md"),
    "confidence": ("confidence", "share of votes, or probability", "u1", 0.005),
    "entropy": ("entropy", "of the classes: 0 sure, 1 not", "u1", 0.005),
    "probability": ("probability", "share of this class", "u1", 0.005),
}
"""Of LAS: the name there, what is said of it, how it is stored."""

RESULTS = published_columns(_COLUMNS, _EXTRA_BYTES)
