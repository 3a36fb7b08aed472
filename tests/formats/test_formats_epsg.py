"""Codes of EPSG beside words of a coordinate system: which are another system's, and which are the same spelled
otherwise."""

from __future__ import annotations

import numpy as np
import pytest
from pyproj import CRS
from pyproj.database import query_crs_info
from pyproj.enums import PJType
from pyproj.exceptions import CRSError

from fwclass.formats import epsg
from fwclass.formats.epsg import projected_named, without_false_codes

SPELLINGS = ("WKT1_GDAL", "WKT1_ESRI", "WKT2_2015", "WKT2_2019")


def coded(crs: CRS, code: str, spelling: str) -> CRS:
    """`crs` as it is spelled, with the code of EPSG that it need not have."""
    text = crs.to_wkt(spelling).rstrip()
    own = crs.to_authority()[1]
    for ends in (f'"EPSG","{own}"]]', f'"EPSG",{own}]]'):
        if text.endswith(ends):
            return CRS.from_wkt(text.removesuffix(ends) + ends.replace(own, code))
    return CRS.from_wkt(f'{text[:-1]},AUTHORITY["EPSG","{code}"]]')


@pytest.mark.parametrize(
    ("own", "false"),
    [
        (25832, 25833),  # zone
        (25832, 32632),  # datum
        (2154, 9793),  # realization of a datum
        (2225, 26941),  # unit
        (26910, 2225),
        (25832, 4326),
        (4258, 4326),
        (5703, 6360),  # unit of heights
        (5703, 5701),  # their zero
        (5715, 5714),  # depths
        (25832, 0),
    ],
)
@pytest.mark.parametrize("spelling", ["WKT1_GDAL", "WKT2_2019"])
def test_a_code_of_another_system_is_left_out(own: int, false: int, spelling: str) -> None:
    words = coded(CRS.from_epsg(own), str(false), spelling)
    crs, faults = without_false_codes(words)
    assert len(faults) == 1 and f"EPSG:{false}" in faults[0][1] and faults[0][0] == ("another" if false else "none")
    assert "id" not in crs.to_json_dict() and crs.equals(words, ignore_axis_order=True)


@pytest.mark.parametrize(("code", "false"), [("25832", "25833"), ("5783", "5703"), ("4258", "4314"), ("7837", "8228")])
def test_one_part_of_a_compound_system(code: str, false: str) -> None:
    heights = code if code in ("5783", "7837") else "5783"
    text = CRS.from_user_input(f"EPSG:25832+{heights}").to_wkt("WKT1_GDAL")
    assert without_false_codes(CRS.from_wkt(text))[1] == ()
    crs, faults = without_false_codes(CRS.from_wkt(text.replace(f'"{code}"', f'"{false}"')))
    assert [kind for kind, _ in faults] == ["another"] and f"EPSG:{false}" in faults[0][1]
    assert CRS.from_wkt(crs.to_wkt()).equals(CRS.from_wkt(text), ignore_axis_order=True)


@pytest.mark.parametrize(
    "kind",
    [
        PJType.PROJECTED_CRS,
        PJType.GEOGRAPHIC_2D_CRS,
        PJType.COMPOUND_CRS,
        PJType.VERTICAL_CRS,
        PJType.GEOGRAPHIC_3D_CRS,
    ],
)
def test_the_same_system_spelled_otherwise_is_silent(kind: PJType) -> None:
    """Names, order of axes, alternatives to parameters, rounded numbers, deprecated codes."""
    known = sorted(int(info.code) for info in query_crs_info("EPSG", kind, allow_deprecated=True))
    rng, tried = np.random.default_rng(7), 0
    for code in rng.permutation(known)[:120]:
        crs = CRS.from_epsg(int(code))
        for spelling in SPELLINGS[:: 2 if crs.is_compound else 1]:
            try:
                words = coded(crs, str(code), spelling)
            except CRSError:  # cannot be spelled so
                continue
            assert without_false_codes(words)[1] == (), (code, spelling)
            tried += 1
    assert tried >= 240


@pytest.mark.parametrize(("own", "code"), [(31467, 5677), (25832, 5555), (4326, 4979), (7405, 27700)])
def test_axes_and_heights_that_a_code_adds_are_no_other_place(own: int, code: int) -> None:
    assert without_false_codes(coded(CRS.from_epsg(own), str(code), "WKT2_2019"))[1] == ()


def test_names() -> None:
    assert projected_named("WGS 84 / UTM zone 33N").to_epsg() == 32633
    assert projected_named("UTM zone 33") is None and projected_named("WGS 84") is None


def test_names_are_listed_once_a_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every text of a file's GeoTIFF keys had PROJ list all systems, a tenth of a second each."""
    listed = []
    monkeypatch.setattr(epsg, "query_crs_info", lambda *words: listed.append(words) or query_crs_info(*words))
    for cache in (epsg.projected_named, epsg._projected_codes):
        cache.cache_clear()
    assert epsg.projected_named("RGF93 v1 / Lambert-93") == CRS.from_epsg(2154)
    assert epsg.projected_named("RGF93 v1") is None and epsg.projected_named("unknown") is None
    assert len(listed) == 1
