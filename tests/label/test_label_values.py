"""The class field: codes, names and mapped values mean reference codes; what means nothing is told."""

import math

import pytest

from fwclass.errors import ConfigError
from fwclass.label.values import NO_CODE, codes_of, groups_of_codes
from fwclass.model import ClassDef

CLASSES = (ClassDef("ground", 2, (2,)), ClassDef("vegetation", 5, (3, 4, 5)), ClassDef("building", 6, (6, 17)))


def codes(values, meaning=None):
    return codes_of(values, meaning or {}, CLASSES, "roofs.gpkg: field klass")[0].tolist()


def test_codes_in_whatever_type_the_file_has():
    assert codes([2, 6.0, "3", " 17 ", None, math.nan, ""]) == [2, 6, 3, 17, NO_CODE, NO_CODE, NO_CODE]


def test_names_of_classes_mean_their_first_code():
    assert codes(["ground", "vegetation", "building"]) == [2, 3, 6]


def test_values_are_mapped_to_codes_classes_or_nothing():
    meaning = {"Dach": 6, "Baum": "vegetation", "Schatten": None, 7: "ground", "2": 6}
    assert codes(["Dach", "Baum", "Schatten", 7, 2, 3], meaning) == [6, 3, NO_CODE, 2, 6, 3]


def test_counts_are_by_value():
    assert codes_of(["ground", 6, 6.0, None], {}, CLASSES, "")[1] == {"6": 2, "ground": 1}


def test_an_unknown_value_is_named_with_how_often_and_what_to_do():
    with pytest.raises(ConfigError) as fault:
        codes(["ground", "Dach", "Dach", "Weg"], {"Baum": 5})
    told = str(fault.value)
    assert "'Dach' (2 features), 'Weg' (1 features)" in told and "roofs.gpkg: field klass" in told
    assert "ground, vegetation, building, Baum" in told and "survey.reference.values={Dach: null}" in told
    for value in ("256", "-1", 2.5, "6b", "²"):
        with pytest.raises(ConfigError, match="stand for no class"):
            codes([2, value])


def test_a_value_mapped_to_nonsense():
    with pytest.raises(ConfigError, match="neither a code nor a class") as fault:
        codes(["Dach"], {"Dach": "roof"})
    assert "survey.reference.values: Dach" in str(fault.value)


def test_values_that_match_no_class():
    with pytest.raises(ConfigError, match="no polygon belongs to any class") as fault:
        codes([9, 9, 11])
    assert "2, 3, 4, 5, 6, 17" in str(fault.value) and "9: 2; 11: 1" in str(fault.value)
    with pytest.raises(ConfigError, match="no value in any feature"):
        codes([None, None])


def test_codes_of_one_class_are_one_group_and_codes_of_none_each_their_own():
    made = codes_of([2, 3, 5, 9, 11], {}, CLASSES, "")[0]
    assert groups_of_codes(made, CLASSES).tolist() == [0, 1, 1, 256 + 9, 256 + 11]
