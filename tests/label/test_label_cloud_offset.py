"""Reference clouds that lie elsewhere: how far is measured whatever the tiles are, and a plain tells nothing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fwclass.decompose.params import PlausibilityParams
from fwclass.errors import QualityError
from fwclass.grid import Box
from fwclass.label.cloud_offset import HALO, MOVES, CloudOffset, compare_heights, offset_of_cloud
from fwclass.report.labels import judge_labels, label_facts
from fwclass.report.write import _uncounted
from fwclass.store.receipts import Receipt

WIDE = 120.0


def town(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    r = np.random.default_rng(5)
    z = 0.02 * x
    for _ in range(60):
        west, south, wide, deep, high = *r.uniform(0, WIDE, 2), *r.uniform(5, 14, 2), r.uniform(3, 12)
        z = np.where((x >= west) & (x < west + wide) & (y >= south) & (y < south + deep), 0.02 * x + high, z)
    return z


def scan(seed: int, east: float = 0.0, north: float = 0.0, per_m2: float = 4.0, surface: Any = town) -> Any:
    """Points of a surface, whose places are told so far beside where they are."""
    r = np.random.default_rng(seed)
    x, y = r.uniform(-20, WIDE + 20, (2, int(per_m2 * (WIDE + 40) ** 2)))
    places = x + east, y + north, surface(x, y) + r.normal(0, 0.05, len(x))
    return tuple(np.round(v, 3) for v in places)


def compared(echoes: Any, cloud: Any, size: float = WIDE) -> Any:
    """Sums and counts of all tiles of `size`, each by what lies in it and around it."""
    total = np.zeros((2, MOVES, MOVES), np.int64)
    for west in np.arange(0.0, WIDE, size):
        for south in np.arange(0.0, WIDE, size):
            box = Box(west, south, min(west + size, WIDE), min(south + size, WIDE))
            near = box.grown(HALO)
            total += compare_heights(*(tuple(v[near.contains(p[0], p[1])] for v in p) for p in (echoes, cloud)), box)
    return total


@pytest.mark.parametrize("per_m2", [0.5, 8.0])
@pytest.mark.parametrize("moved", [(0.0, 0.0), (0.8, 0.0), (-1.1, 1.6), (3.0, -4.0), (0.0, 7.9)])
def test_the_offset_comes_out(moved: tuple[float, float], per_m2: float) -> None:
    offset = offset_of_cloud(*compared(scan(1, per_m2=per_m2), scan(2, *moved, per_m2=per_m2)))
    assert offset is not None and not offset.edge
    assert (offset.x, offset.y) == pytest.approx((-moved[0], -moved[1]), abs=0.25)
    assert offset.least <= offset.unmoved


@pytest.mark.statistics
@pytest.mark.parametrize("size", [7.3, 30.0, 41.0])
def test_the_tiles_change_no_sum(size: float) -> None:
    echoes, cloud = scan(1, per_m2=1.0), scan(2, 1.3, per_m2=1.0)
    whole = compared(echoes, cloud)
    assert (compared(echoes, cloud, size) == whole).all() and whole.all()


def test_further_than_it_is_moved_is_told_as_at_least_so_far() -> None:
    offset = offset_of_cloud(*compared(scan(1), scan(2, 10.4)))
    assert offset is not None and offset.edge and offset.x == -10.0


@pytest.mark.parametrize("surface", [lambda x, y: 0.0 * x, lambda x, y: np.where(x % 100 < 40, 0.1, 0.0)])
def test_a_plain_tells_nothing(surface: Any) -> None:
    assert offset_of_cloud(*compared(scan(1, surface=surface), scan(2, 3.0, surface=surface))) is None


def test_no_cloud_and_no_echoes_tell_nothing() -> None:
    none = tuple(np.empty((3, 0)))
    for pair in ((scan(1), none), (none, scan(1)), (none, none)):
        assert offset_of_cloud(*compared(*pair)) is None


@pytest.mark.parametrize(
    ("offset", "remarks", "unsound"),
    [
        (CloudOffset(-0.4, 0.3, False, 0.2, 0.3), 0, False),
        (CloudOffset(-0.8, 0.0, False, 0.2, 0.4), 1, False),
        (CloudOffset(-0.8, 1.9, False, 0.2, 0.9), 1, True),
        (CloudOffset(-10.0, 0.0, True, 0.2, 1.1), 1, True),
    ],
)
def test_it_is_told_and_far_ones_are_refused(
    offset: CloudOffset, remarks: int, unsound: bool, base: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    params = PlausibilityParams(**base["plausibility"])
    monkeypatch.setattr("fwclass.report.labels.offset_of_cloud", lambda *tables: offset)
    square = np.zeros((MOVES, MOVES), int).tolist()
    receipt = Receipt.__new__(Receipt)
    object.__setattr__(receipt, "meta", {"moved": {"sums": square, "counts": square}})
    trained = Receipt.__new__(Receipt)
    object.__setattr__(trained, "meta", {})
    facts = label_facts([trained], [], params, [receipt])
    assert facts is not None and len(facts["remarks"]) == remarks
    if not unsound:
        judge_labels(facts, params, "run")
        return
    assert ("or more" in facts["elsewhere"]) == offset.edge
    with pytest.raises(QualityError, match="do not lie where the echoes are") as fault:
        judge_labels(facts, params, "run")
    assert "1.9 m to the north" in fault.value.got or offset.edge


def test_much_of_the_survey_is_of_no_class(base: dict[str, Any]) -> None:
    params = PlausibilityParams(**base["plausibility"])
    sampled = Receipt.__new__(Receipt)
    object.__setattr__(sampled, "meta", {})
    for share, told in ((0.19, ""), (0.336, "33.6 % of the echoes")):
        facts = label_facts([sampled], [], params, uncounted=share)
        assert facts is not None and facts["uncounted"] == told
        if told:
            with pytest.raises(QualityError, match="is of none of its classes"):
                judge_labels(facts, params, "run")
        else:
            judge_labels(facts, params, "run")


@pytest.mark.parametrize(
    ("labelled", "only", "blank", "share"),
    [
        ([60, 60, 60, 60], (), 0, 0.4),
        ([60, 60, 60, 60], (), 100, 0.2),
        ([60, 60, 60, 0], (), 0, 0.0),
        ([60, 60, 60], (), 0, 0.0),
        ([60] * 4, (0, 1), 0, 0.0),
    ],
)
def test_a_survey_with_labels_here_and_there_is_none_that_was_sorted(
    labelled: list[int], only: tuple[int, ...], blank: int, share: float
) -> None:
    kept = SimpleNamespace(only=only, keep=())
    config = SimpleNamespace(survey=SimpleNamespace(reference=SimpleNamespace(kind="source")), classify=kept)
    tiles = [{"echoes": 100, "labelled": [n, 0]} for n in labelled]
    other = 100 * len(tiles) - sum(labelled)
    counted = {"tiles": tiles, "echoes": 100 * len(tiles)}
    counted |= {"left_codes": {"1": other - blank}, "without_classes": {"a.las": blank}}
    assert _uncounted(config, counted) == share  # type: ignore[arg-type]
