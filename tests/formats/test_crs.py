"""Codes of coordinate systems."""

from pyproj import CRS

from fwclass.formats.crs import epsg_of


def test_a_code_that_is_no_number_is_none():
    plain = CRS.from_epsg(25832).to_json_dict()
    assert epsg_of(CRS.from_json_dict(plain)) == 25832
    for code in ("3263.", "x"):
        plain["id"]["code"] = code
        assert epsg_of(CRS.from_json_dict(plain)) in (None, 25832)
