"""Segments from answers whose crowns are known."""

import math
from collections import Counter

import numpy as np
import pytest
from streetmaker import config

from fwclass.street import prescription
from fwclass.street.answers import Answer, make_answer
from fwclass.street.frames import Frame, Scan
from fwclass.street.prescription import Prescriber, seen_again, segments
from fwclass.street.prescription_map import write_map
from fwclass.street.sphere_kernels import UNIT
from fwclass.street.track import Track


def answers(speed=1.0, frames=80):
    """A crown from x = 0.5 to 1.25 m, 4 to 5 m to the right, 1 to 3 m above the scanner."""
    y, z = np.meshgrid(np.arange(-4.95, -4.0, 0.1), np.arange(1.05, 3.0, 0.1))
    y, z = y.ravel().astype(np.float32), z.ravel().astype(np.float32)
    for k in range(frames):
        place = speed * 0.025 * k
        crown = 5 if 0.5 <= place < 1.25 else 2
        codes = np.full(len(y), crown, np.uint8)
        yield Answer(k, 0.025 * k, place, codes, np.full(len(y), 90, np.uint8), y, z)


def test_a_crown_becomes_segments():
    params = config().street
    made = segments(answers(), params, 5)[0]
    assert [(s.begin, s.end, s.side) for s in made] == [
        (0.5, 0.75, "right"),
        (0.75, 1.0, "right"),
        (1.0, 1.25, "right"),
    ]
    for s in made:
        assert (s.low, s.high, s.near, s.far) == pytest.approx((2.85, 4.75, 4.05, 4.95), abs=0.01)
        assert s.returns == 10 * 200
        assert s.volume == pytest.approx(0.25 * 1.0 * 2.0)  # half a voxel of 0.1 m lies in the next segment
        assert s.speed == pytest.approx(1.0, rel=1e-6)
        assert s.seconds == pytest.approx(1.5 - 0.25 - 0.3)


def test_a_nozzle_too_near_has_no_time_left():
    params = config("street.prescription.nozzle=0.2").street
    assert all(s.seconds < 0 for s in segments(answers(), params, 5)[0])


def test_a_vehicle_that_stands_has_no_speed():
    made, _ = segments(
        (
            Answer(k, 0.025 * k, 0.6, a.classification, a.confidence, a.y, a.z)
            for k, a in enumerate(list(answers())[25:45])
        ),
        config().street,
        5,
    )
    assert len(made) == 1
    assert made[0].speed == 0 or math.isnan(made[0].speed)
    assert math.isnan(made[0].seconds)


@pytest.mark.statistics
@pytest.mark.parametrize(("pitch", "yaw"), [(0, 30), (0, -30), (20, 0), (-15, 10)])
def test_returns_of_a_turned_scanner_are_prescribed_where_they_lie(pitch, yaw):
    """They were given their frame's place: 3.4 m off in the median with 40 degrees of yaw."""
    params = config(f"street.mounting.pitch={pitch}", f"street.mounting.yaw={yaw}").street
    track, random = Track(params), np.random.default_rng(1)
    scan, made = Scan(90, -2.0, 0.045, 0.1, 9.0), []
    wanted = Counter()
    for k in range(250):
        ranges = random.uniform(0.1, 8.99, scan.beams).astype(np.float32)
        placed = track.take(Frame(k, 0.025 * k, scan, ranges, place=0.04 * k))
        made.append(make_answer(placed, np.full(scan.beams, 5, np.uint8), np.ones(scan.beams)))
        place = np.floor((placed.place + placed.x) * UNIT / params.prescription.segment).astype(int)
        wanted.update(zip(np.where(placed.y >= 0, "left", "right"), place.tolist(), strict=True))
    assert placed.place * UNIT == pytest.approx(9.96, abs=0.02)
    given, again = segments(made, params, 5, track.geometry)
    keys = [(s.side, round(s.begin / params.prescription.segment)) for s in given]
    assert again == 0 and len(set(keys)) == len(keys)
    assert dict(zip(keys, (s.returns for s in given), strict=True)) == {k: n for k, n in wanted.items() if n >= 5}
    assert sum(np.isfinite(s.speed) for s in given) > 60
    early = Prescriber(params, 5, track.geometry)
    assert sum(len(list(early.take(one))) for one in made) > 0  # while it drives


def test_a_vehicle_that_goes_back_gets_no_segment_twice():
    """38 of 177 segments were written twice, and their rectangles lay upon each other."""
    ahead = list(answers())
    way = [*range(36), *range(36, 12, -1), *range(12, 80)]
    made = [
        Answer(k, 0.025 * k, a.place, a.classification, a.confidence, a.y, a.z)
        for k, a in enumerate(ahead[at] for at in way)
    ]
    given, again = segments(made, config().street, 5)
    assert [(s.begin, s.returns // 200) for s in given] == [(0.5, 10), (0.75, 6 + 7 + 10), (1.0, 10)]
    assert again == 200 * (10 + 10)
    assert "4,000 crown returns" in seen_again(again)[0] and seen_again(0) == []


def test_a_vehicle_that_only_goes_back_has_segments_on_the_way():
    prescriber, place = Prescriber(config().street, 5), 30.0
    y, crown = np.full(50, 3.0, np.float32), np.full(50, 5, np.uint8)
    early = []
    for k in range(1200):
        place -= 0.025
        early += prescriber.take(Answer(k, 0.025 * k, place, crown, crown, y, y))
        assert len(prescriber._open) <= 42
    assert len(early) > 70 and len({s.begin for s in early}) == len(early)


def noisy(frames, seed=1):
    """Of a vehicle that drives, and then stands: every range is another by some millimetres."""
    random = np.random.default_rng(seed)
    for k in range(frames):
        y, z = (
            np.rint(1024 * random.normal(0, 0.01, 200)) / 1024 + np.linspace(a, b, 200) for a, b in ((-5, 4), (1, 3))
        )
        codes = np.where(np.arange(200) % 3, 5, 2).astype(np.uint8)
        place = min(0.01 * k, 0.6)
        yield Answer(k, 0.025 * k, place, codes, codes, y.astype(np.float32), z.astype(np.float32))


def test_segments_are_the_same_however_few_returns_are_held(monkeypatch):
    made = [segments(noisy(200), config().street, 5)[0]]
    monkeypatch.setattr(prescription, "HELD", 300)
    made.append(segments(noisy(200), config().street, 5)[0])
    assert made[0] == made[1] and len(made[0]) == 6


def test_percentiles_of_counted_values_are_those_of_all():
    random = np.random.default_rng(3)
    for n in (1, 2, 3, 50, 977):
        values, counts = random.normal(0, 1, n), random.integers(1, 9, n)
        of = (0.0, 2.0, 49.7, 98.0, 100.0)
        whole = np.percentile(np.repeat(values, counts), of)
        assert prescription.percentiles(values, counts, of) == whole.tolist()


@pytest.mark.statistics
@pytest.mark.parametrize("spread", [0.01, 10.0], ids=["of a scanner", "of a sender that means harm"])
def test_memory_does_not_grow_while_the_vehicle_stands(spread, monkeypatch):
    """It took 24 bytes for every return, for as long as it stood: 2 GB an hour."""
    monkeypatch.setattr(prescription, "HELD", 2_000)
    monkeypatch.setattr(prescription, "MOST", 20_000)
    monkeypatch.setattr(prescription, "LEAST", 2_000)
    prescriber, random = prescription.Prescriber(config().street, 5), np.random.default_rng(1)
    crown, most = np.full(1000, 5, np.uint8), 0
    for k in range(300):
        y, z = (random.normal(3, spread, 1000).astype(np.float32) for _ in "yz")
        assert not list(prescriber.take(Answer(k, 0.025 * k, 0.6, crown, crown, y, z)))
        most = max(most, sum(one.held for one in prescriber._open.values()))
    assert most <= 3 * 20_000
    made = list(prescriber.rest())
    assert sum(s.returns for s in made) == 300 * 1000
    assert all(abs(s.near) < 3.1 for s in made)


def test_the_map_is_read_by_geopandas(tmp_path):
    geopandas = pytest.importorskip("geopandas")
    made = segments(answers(), config().street, 5)[0]
    write_map(tmp_path / "p.parquet", made)
    frame = geopandas.read_parquet(tmp_path / "p.parquet")
    assert frame.crs is None
    assert list(frame.total_bounds) == pytest.approx([0.5, -4.95, 1.25, -4.05], abs=0.01)
    assert frame.geometry.is_valid.all()
    write_map(tmp_path / "none.parquet", [])
    assert len(geopandas.read_parquet(tmp_path / "none.parquet")) == 0
