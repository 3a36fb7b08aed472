"""Source files that hold no classes, where others do."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from fwclass.report.sampling import _less, _of_blank_files, files_without_classes

FILES = {"a.laz": {2: 50, 6: 40, 1: 10}, "b.laz": {1: 90, 0: 9, 7: 1}, "c.laz": {2: 5}}


def test_files_that_nobody_has_sorted() -> None:
    assert files_without_classes(FILES) == {"b.laz": FILES["b.laz"]}
    assert files_without_classes({"b.laz": {1: 90}}) == {}, "where no other file is sorted, none stands out"
    assert _less({"1": 100, "9": 3}, [FILES["b.laz"]]) == {"1": 10, "9": 3}
    assert _less({"1": 90}, [FILES["b.laz"]]) == {}


@pytest.mark.parametrize(("codes", "words"), [((6,), "and not tested"), ((1, 6), "is learned, and tested, as thing")])
def test_what_becomes_of_them_is_said(codes: tuple[int, ...], words: str) -> None:
    classes = [SimpleNamespace(name="ground", codes=(2,)), SimpleNamespace(name="thing", codes=codes)]
    config = SimpleNamespace(classes=classes)
    (remark,) = _of_blank_files({"b.laz": {1: 90}}, config)  # type: ignore[arg-type]
    assert "1 file (b.laz)" in remark and words in remark
    assert _of_blank_files({}, config) == []  # type: ignore[arg-type]
