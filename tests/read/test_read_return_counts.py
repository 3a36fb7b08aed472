"""What returns say of themselves, counted in spans that add up."""

import numpy as np
import pytest

from fwclass.read.return_counts import (
    EDGES,
    coarse_steps,
    count_returns,
    join_counts,
    join_lattices,
    lattice_of,
    median_intensity,
    missing_returns,
    slant_ratio,
)
from fwclass.schema import Table


def returns(rows=4_000, seed=1, step=0.01):
    r = np.random.default_rng(seed)
    of = r.integers(1, 4, rows)
    return Table(
        {
            **{axis: 5_400_000.0 + step * r.integers(0, 90_000, rows) for axis in "xyz"},
            "gps_time": r.uniform(0, 50, rows),
            "return_number": r.integers(1, of + 1),
            "number_of_returns": of,
            "intensity": r.integers(0, 3_000, rows),
            "vendor_amplitude": np.full(rows, np.nan),
        }
    )


@pytest.mark.parametrize("cuts", [1, 7, 400])
@pytest.mark.parametrize("step", [0.01, 0.25, 1.0])
def test_spans_add_up_to_their_file(cuts, step):
    table = returns(step=step)
    whole = join_counts([count_returns(table)])
    whole["following"] = None  # times are all of their own, and cuts may part a pulse
    ends = np.linspace(0, table.rows, cuts + 1).astype(int)
    parts = [count_returns(table.take(np.arange(a, b))) for a, b in zip(ends, ends[1:], strict=False)]
    joined = join_counts(np.random.default_rng(2).permutation(np.array(parts, object)))
    joined["following"] = None
    assert {n: v for n, v in joined.items() if n != "missing"} == {n: v for n, v in whole.items() if n != "missing"}
    assert joined["lattice"][0][2] == round(1000 * step)
    assert sum(whole["intensities"].values()) == (table["number_of_returns"] == 1).sum()


def test_nothing_says_nothing():
    assert join_counts([]) == join_counts([count_returns(returns(0))])
    assert count_returns(returns(0))["intensity"] is None


def test_amplitudes_of_the_vendor_are_not_intensities():
    table = returns().with_columns({"vendor_amplitude": np.full(4_000, 12.5)})
    assert count_returns(table)["intensities"] == {}


def test_the_median_lies_in_its_class():
    for seed in range(20):
        values = np.random.default_rng(seed).integers(0, 3 * 4**seed % 60_000 + 2, 999)
        kinds, counts = np.unique(np.searchsorted(EDGES, values, "right"), return_counts=True)
        got = median_intensity(dict(zip(map(str, kinds.tolist()), counts.tolist(), strict=True)))
        median = int(np.median(values))
        assert got <= median and (median <= 1.2 * got + 1)
    assert median_intensity({}) == 0


def test_lattices():
    assert lattice_of(np.array([5.0, 7.5, 10.0])) == [5000, 10_000, 2500]
    assert lattice_of(np.array([5.0, 5.0])) == [5000, 5000, 0] and lattice_of(np.array([np.nan, 1e300])) == [0, 0, 0]
    assert join_lattices([[5000, 5000, 0], [6000, 6000, 0]]) == [5000, 6000, 1000]
    assert coarse_steps([[0, 20_000, 1000], [3, 20_003, 10], [0, 1250, 250]]) == "x 1, z 0.25"
    assert coarse_steps([[0, 4000, 1000], [0, 0, 0], [0, 8000, 40]]) == "", "level surfaces, one height, fine ones"
    mixed = np.r_[np.arange(3_000) * 1.0, 0.5]  # one alone, behind the first look
    assert lattice_of(mixed)[2] == 500


def test_returns_that_follow_each_other():
    pulses = np.repeat(np.arange(500), 3)
    table = Table(
        {
            **{axis: 100.0 - np.tile([0.0, 2.0, 2.0], 500) for axis in "xyz"},
            "gps_time": pulses * 0.1,
            "return_number": np.tile([1, 2, 3], 500),
            "number_of_returns": np.full(1500, 3),
            "intensity": np.ones(1500, int),
            "vendor_amplitude": np.full(1500, np.nan),
        }
    )
    assert count_returns(table)["following"] == [1000, 1000]
    order = np.random.default_rng(1).permutation(1500)
    assert count_returns(table.take(order))["following"] == [1000, 1000]
    backward = table.with_columns({"return_number": np.tile([3, 2, 1], 500)})
    assert count_returns(backward)["following"] == [1000, 500]


def test_points_thinned_one_by_one_are_not_pulses_thinned():
    """The counts by number of return stay balanced, and nothing told of it."""
    r = np.random.default_rng(2)
    of = r.integers(1, 4, 4000)
    pulse, number = np.repeat(np.arange(4000), of), np.concatenate([np.arange(1, n + 1) for n in of])
    time = pulse * 1e-5
    same = dict.fromkeys(("x", "y", "z", "vendor_amplitude"), np.full(len(pulse), np.nan))
    table = Table({**same, "gps_time": time, "return_number": number, "number_of_returns": of[pulse]})
    table = table.with_columns({"intensity": np.ones(len(pulse), int)})
    must = int((number < of[pulse]).sum())
    assert count_returns(table)["kept"] == [must, must]
    by_pulse = table.take(np.flatnonzero(r.random(4000)[pulse] < 0.3))
    before, after = count_returns(by_pulse)["kept"]
    assert before == after > 0.25 * must
    one_by_one = table.take(np.flatnonzero(r.random(len(pulse)) < 0.5))
    before, after = count_returns(one_by_one)["kept"]
    assert after / before == pytest.approx(0.5, abs=0.05)
    shuffled = one_by_one.take(r.permutation(one_by_one.rows))
    still, own = (one_by_one.with_columns({"gps_time": f * np.arange(one_by_one.rows)}) for f in (0.0, 1e-7))
    for not_told in (shuffled, still, own):
        assert count_returns(not_told)["kept"] == [0, 0]
    assert count_returns(one_by_one, None, True)["kept"] == [0, 0]


def test_returns_that_are_missing():
    pairs = np.zeros((16, 16), np.int64)
    pairs[1, 2], pairs[2, 2], pairs[3, 3] = 5, 3, 4
    assert missing_returns(pairs) == 2 + 8


def slanted(per_metre=1.0, spread=0.0, rows=2_000):
    """Pulses of two returns along their beams, heights in so many units a metre; and scan angles [degrees]."""
    r = np.random.default_rng(4)
    pulse, number = np.divmod(np.arange(rows), 2)
    angle, way, fall = (
        r.uniform(-30, 30, rows)[pulse],
        r.uniform(0, 2 * np.pi, rows)[pulse],
        r.uniform(1, 20, rows)[pulse],
    )
    aside = number * fall * np.tan(np.radians(np.abs(angle)))
    told = angle + spread * r.normal(size=rows)[pulse]
    table = Table(
        {
            "x": 5e5 + aside * np.cos(way),
            "y": 5e6 + aside * np.sin(way),
            "z": per_metre * (200.0 - number * fall),
            "gps_time": pulse * 1e-5,
            "return_number": number + 1,
            "number_of_returns": np.full(rows, 2),
            "intensity": np.ones(rows, np.int64),
            "vendor_amplitude": np.full(rows, np.nan),
        }
    )
    return table, told.astype(np.float32)


@pytest.mark.parametrize(("per_metre", "ratio"), [(1.0, 1.0), (1 / 0.3048, 0.3048), (0.3048, 1 / 0.3048)])
def test_beams_lean_as_their_scan_angles_tell_unless_units_differ(per_metre, ratio):
    table, angle = slanted(per_metre)
    counted = count_returns(table, angle)
    known = (np.abs(angle[::2]) >= 10) & (-np.diff(table["z"])[::2] >= 2)
    assert sum(counted["slants"]) == known.sum()
    median, wide = slant_ratio(counted["slants"])
    assert median == pytest.approx(ratio, rel=0.05) and wide < 1.1
    shuffled = np.random.default_rng(5).permutation(table.rows)
    assert count_returns(table.take(shuffled), angle[shuffled])["slants"] == counted["slants"]
    assert join_counts([counted, counted, count_returns(returns(0))])["slants"] == [2 * n for n in counted["slants"]]


def test_of_beams_without_angles_or_too_few_nothing_is_said():
    table, angle = slanted(rows=200)
    assert "slants" not in count_returns(table)
    assert np.isnan(slant_ratio(count_returns(table, angle)["slants"])[0])
    assert np.isnan(slant_ratio(join_counts([count_returns(table)])["slants"])[0])
    assert sum(count_returns(table, 0 * angle)["slants"]) == 0
    wide = count_returns(*slanted(spread=12.0))["slants"]
    assert slant_ratio(wide)[1] > 1.3
