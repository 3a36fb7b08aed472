"""Echoes that no scene makes are told and end with exit code 4; what scenes make is neither."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from commandline import fwclass
from numpy.typing import NDArray
from rawmaker import scene, write_parquet

from fwclass.decompose.fitted_echoes import SATURATED
from fwclass.decompose.placement import Placement
from fwclass.decompose.recurring import BEHIND, IN_RECORD, OVERLOADED, Recurring, recurring_echoes
from fwclass.report.recurring import recurring_facts, recurring_remarks

FWHM, TOLERANCE = 4.0, 5.0


def recurring(row: NDArray, time: NDArray, amplitude: NDArray, full: float = np.inf) -> dict[str, Recurring]:
    order = np.random.default_rng(0).permutation(len(row))
    flags = np.where(amplitude >= full, SATURATED, 0).astype(np.uint8)
    fits = SimpleNamespace(row=row[order], time=time[order], amplitude=amplitude[order], flags=flags[order])
    return {one.of: one for one in recurring_echoes(cast(Any, fits), FWHM, TOLERANCE)}


def main_echoes(n: int, rng: np.random.Generator) -> tuple[NDArray, NDArray, NDArray]:
    return np.arange(n), rng.uniform(20.0, 120.0, n), np.exp(rng.uniform(np.log(20.0), np.log(200.0), n))


@pytest.mark.parametrize("gap", [-8.3, 3.1, 41.7])
def test_what_follows_by_one_time_and_share_is_found(gap: float) -> None:
    rng = np.random.default_rng(1)
    row, time, height = main_echoes(2000, rng)
    some = rng.permutation(2000)[:300]
    more = recurring(
        np.append(row, some),
        np.append(time, time[some] + gap + rng.normal(0.0, 0.1, 300)),
        np.append(height, 0.1 * height[some]),
    )
    assert list(more) == [BEHIND]
    one = more[BEHIND]
    assert one.share == one.waveforms / 2000 and 0.12 < one.share <= 0.15
    assert abs(one.time - gap) <= 0.5 * FWHM and 0.05 < one.height < 0.2 and one.separate == (abs(gap) > TOLERANCE)


def test_what_saturation_leaves_behind_is_found_whatever_its_height() -> None:
    rng = np.random.default_rng(4)
    row, time, height = main_echoes(2000, rng)
    some = np.flatnonzero(height > 120.0)
    left = np.exp(rng.uniform(np.log(1.0), np.log(100.0), len(some)))
    more = np.append(row, some), np.append(time, time[some] + 12.0 + rng.normal(0.0, 0.3, len(some)))
    kinds = recurring(*more, np.append(height, left), full=120.0)
    assert set(kinds) == {OVERLOADED} and 0.15 < kinds[OVERLOADED].share <= len(some) / 2000
    assert abs(kinds[OVERLOADED].time - 12.0) <= 2.0
    assert all(one.share < 0.02 for one in recurring(*more, np.append(height, left)).values())


def test_what_stands_at_one_place_of_the_record_is_found() -> None:
    rng = np.random.default_rng(2)
    row, time, height = main_echoes(2000, rng)
    some = rng.permutation(2000)[:200]
    place, size = 77.0 + rng.normal(0.0, 0.1, 200), 14.0 * np.exp(rng.normal(0.0, 0.03, 200))
    more = recurring(np.append(row, some), np.append(time, place), np.append(height, size))
    one = more[IN_RECORD]
    assert 0.08 < one.share <= 0.1 and abs(one.time - 77.0) <= 2.0 and 7.0 < one.height < 28.0


def test_first_echoes_as_low_as_what_triggers_the_receiver_are_the_scenes() -> None:
    """Records begin 23 ns before an echo of 12 DN or more: where it is the highest, and where it is not."""
    rng = np.random.default_rng(5)
    height = 12.0 + rng.exponential(30.0, 4000)
    some = np.flatnonzero(height < 20.0)
    row, time = np.arange(4000), 23.0 + rng.normal(0.0, 0.3, 4000)
    more = np.append(row, some), np.append(time, time[some] + rng.uniform(8.0, 90.0, len(some)))
    kinds = recurring(*more, np.append(height, rng.uniform(30.0, 200.0, len(some))))
    assert IN_RECORD not in kinds or kinds[IN_RECORD].share < 0.01


@pytest.mark.parametrize("gap", [-26.0, 26.0])
def test_roofs_of_glass_are_the_scenes(gap: float) -> None:
    rng = np.random.default_rng(6)
    row, time, height = main_echoes(2000, rng)
    some = rng.permutation(2000)[:400]
    kinds = recurring(np.append(row, some), np.append(time, time[some] + gap), np.append(height, 0.5 * height[some]))
    assert all(one.share < 0.01 for one in kinds.values())


@pytest.mark.parametrize("first", [False, True])
def test_what_scenes_make_is_not(first: bool) -> None:
    """Second echoes at any distance and of any height, of records that begin anywhere, or 30 ns before the first."""
    rng = np.random.default_rng(3)
    row, time, height = main_echoes(4000, rng)
    time = np.full(4000, 30.0) + rng.uniform(0.0, 1.0, 4000) if first else time
    more = np.append(row, row[:2000]), np.append(time, time[:2000] + rng.gamma(2.0, 6.0, 2000) + 3.0)
    height = np.append(height, np.exp(rng.uniform(np.log(10.0), np.log(200.0), 2000)))
    assert all(one.share < 0.01 for one in recurring(*more, height).values())
    assert recurring(np.arange(0), np.zeros(0), np.zeros(0)) == {} == recurring(row[:9], time[:9], height[:9])


def test_placements_remember_it() -> None:
    kept = Placement(recurring=(Recurring(BEHIND, 3.0, 0.1, False, 12, 0.25),))
    assert Placement.from_json(kept.to_json()) == kept


def test_echoes_that_the_vendor_has_are_the_scenes() -> None:
    """The roof of a greenhouse lies as far above the ground everywhere: its returns are there."""
    kind = {"of": BEHIND, "time": -26.0, "height": 0.5, "separate": True, "waveforms": 600, "share": 0.3}
    counts = {"fitted": 3000, "waveforms": 2000, "unexplained": 20}
    facts = recurring_facts({"recurring": [kind]}, counts, 3000)
    assert facts["recurring_share"] == 0.01 and facts["recurring"] == 20
    assert recurring_remarks([{"name": "a", **facts}]) == []
    for whole in (recurring_facts({"recurring": [kind]}, counts, 0), recurring_facts(places(kind), counts, 3000)):
        assert whole["recurring_share"] == 0.3
    (words,) = recurring_remarks([{"name": "a", **recurring_facts(places(kind), counts, 3000)}])
    assert "30.0 % of the waveforms" in words and "26.0 ns before the highest, 0.5 times as high" in words


def places(kind: dict[str, Any]) -> dict[str, Any]:
    return {"recurring": [kind | {"separate": False}]}


def crosstalk(samples: NDArray) -> NDArray:
    at = np.arange(samples.shape[1])
    return samples + 25.0 * np.exp(-0.5 * ((at - 62.0) / 1.7) ** 2)


def ringing(samples: NDArray) -> NDArray:
    """Of a share that is not the same in all waveforms: where it is, it is taken off (`copies`)."""
    late = np.roll(samples - 12.0, 14, axis=1)
    late[:, :14] = 0.0
    return samples + np.random.default_rng(8).uniform(0.19, 0.31, (len(samples), 1)) * late


@pytest.mark.parametrize(
    ("change", "said"), [(crosstalk, "62.0 ns after the first sample"), (ringing, "ns behind the highest, 0.2")]
)
def test_receivers_that_make_echoes_end_with_4(tmp_path: Path, change: Any, said: str) -> None:
    truth = scene(pulses=600, n=100)
    columns = truth.columns(at="sensor")
    samples = np.stack(columns["samples"]).astype(np.float64)
    for wrong in (False, True):
        kept = np.clip(np.rint(change(samples) if wrong else samples), 0, 255).astype(np.uint8)
        write_parquet(
            tmp_path / "a.parquet", columns | {"samples": list(kept)}, {"crs": "EPSG:32632", "spacing_ns": "1.0"}
        )
        ended = fwclass("decompose", tmp_path / "a.parquet", tmp_path / "a.laz", "--overwrite")
        assert ended.returncode == (4 if wrong else 0), ended.stderr
        assert ("waveforms have an echo that no scene makes" in ended.stderr) == wrong
        assert (said in ended.stderr) == wrong, ended.stderr
