"""Where echoes are placed: the vendor's constant and range walk, the clock's phase, the outgoing pulse. Files written
byte by byte, scored against what was put in."""

from __future__ import annotations

import laspy
import numpy as np
import pytest
from lasmaker import METRES_PER_NS, digitise, gaussian, write_las
from plsmaker import OUTGOING, Descriptor, Pulse, Sampling, write_pls
from rawmaker import SIGMA, scene, write_parquet

from fwclass import conf
from fwclass.decompose.plausible import COUNTS
from fwclass.report.plausibility import strip_plausibility
from fwclass.report.plausibility_remarks import plausibility_remarks
from fwclass.single_file.decompose import decompose_file

FLUCTUATES = 0x8FFFFFFF
PULSES = 900


def walk(height):
    """How much earlier than the pulse's peak this vendor's return lies [ns]: a share of the rising edge, and slower."""
    return 1.3 + 0.45 * np.log(height / 60.0)


def strip(path, location, seed=1, pulses=PULSES, change=None, **options):
    """Single returns on flat ground; `location` gives the vendor's [ns] from true times, heights and a generator."""
    rng = np.random.default_rng(seed)
    height, time = np.exp(rng.uniform(np.log(12.0), np.log(220.0), pulses)), 25.0 + rng.uniform(0.0, 8.0, pulses)
    xyz = np.c_[
        500000.0 + 0.5 * (np.arange(pulses) % 30), 5400000.0 + 0.5 * (np.arange(pulses) // 30), np.full(pulses, 200.0)
    ]
    waveforms = [
        digitise(gaussian(70, [(a, t, 3.6)], 10.0) + rng.normal(0.0, 0.6, 70))
        for a, t in zip(height, time, strict=True)
    ]
    stored = location(time, height, rng)
    if change:
        change(xyz)
    return write_las(
        path,
        xyz,
        waveforms=waveforms,
        pulse=np.arange(pulses),
        location=stored,
        gps_time=1000.0 + 1e-5 * np.arange(pulses),
        intensity=np.rint(height),
        descriptors={1: _samples(70)},
        **options,
    )


def _samples(n):
    from lasmaker import Descriptor as OfLas

    return OfLas(8, n, 1000)


def echoes(path, *settings):
    """z of the echoes, sorted by time, and the words."""
    out = path.with_suffix(".out.laz")
    words, judged = decompose_file(path, out, settings, True)
    las = laspy.read(out)
    order = np.argsort(np.asarray(las.gps_time), kind="stable")
    return np.asarray(las.z)[order] - 200.0, np.asarray(las.gps_time)[order], words, judged["plausibility"]["places"]


def test_a_vendors_constant_and_range_walk_are_taken_off(tmp_path):
    path = strip(tmp_path / "a.las", lambda t, a, rng: t - walk(a) + rng.normal(0.0, 0.05, len(t)))
    z, _, words, places = echoes(path)
    assert len(z) == PULSES and "+1." in words and "decompose.vendor_offset" in words
    assert (np.abs(z) < 0.05).mean() > 0.95 and abs(np.median(z)) < 0.01
    (channel,) = places["vendor_offset"]
    assert channel["echoes"] > 0.9 * PULSES and not channel["phase"] and channel["scatter"] < 0.15
    np.testing.assert_allclose(channel["offsets"], walk(np.array(channel["heights"])), atol=0.08)
    stored, _, _, none = echoes(path, "decompose.vendor_offset=keep", "decompose.register_within=0")
    assert none["vendor_offset"] == [] and np.median(stored) < -0.15
    assert np.ptp([np.median(stored[k::3]) for k in range(3)]) < 0.05


@pytest.mark.parametrize("rough", [0.0, 0.05])
def test_a_walk_that_places_have_too_is_left_in(tmp_path, rough):
    """Returns on the rising edge, and their places there: the peak of the pulse is where the ground is."""
    ground = np.random.default_rng(7).normal(0.0, rough, PULSES)
    off = []

    def location(time, height, rng):
        off.append(2.0 + walk(height))
        return time - off[0]

    def change(xyz):
        xyz[:, 2] += ground + off[0] * METRES_PER_NS

    z, _, words, places = echoes(strip(tmp_path / "a.las", location, change=change))
    assert "his places go with them" in words and "is taken off" not in words, words
    assert places["vendor_offset"][0]["alike"] and places["vendor_offset"][0]["offsets"] == [0.0]
    assert np.median(np.abs(z - ground)) < 0.01 and (np.abs(z - ground) < 0.05).mean() > 0.98


@pytest.mark.parametrize(
    "begin, end", [(1.0, 1.0), (1.02, 1.02), pytest.param(0.98, 0.98, marks=pytest.mark.slow), (0.985, 1.015)]
)
def test_a_sample_spacing_that_returns_contradict_is_told(tmp_path, begin, end):
    """Of the whole strip, and one that drifts from a share too short to as much too long."""
    rng, n = np.random.default_rng(3), 600
    time, height = rng.uniform(20.0, 90.0, n), rng.uniform(30.0, 200.0, n)
    noise = rng.normal(0.0, 0.6, (n, 120))
    waves = [digitise(gaussian(120, [(height[i], time[i], 3.6)], 10.0) + noise[i]) for i in range(n)]
    place = np.c_[500000.0 + 0.5 * (np.arange(n) % 30), 5400000.0 + 0.5 * (np.arange(n) // 30), np.full(n, 200.0)]
    location = time * np.linspace(begin, end, n)
    options = {"gps_time": 1000.0 + 1e-5 * np.arange(n), "descriptors": {1: _samples(120)}}
    path = write_las(tmp_path / "a.las", place, waveforms=waves, pulse=np.arange(n), location=location, **options)
    _, _, words, places = echoes(path)
    assert ("not as far apart as the file says" in words) == (end != 1.0), words
    stretch = places["vendor_offset"][0]["stretch"]
    if begin == end:
        assert stretch == pytest.approx(1.0 / end - 1.0, abs=0.002)
    else:
        assert 0.008 < abs(stretch) < 0.016


@pytest.mark.parametrize(
    "late",
    [
        0.0,
        np.linspace(-0.3, 0.3, PULSES),
        pytest.param(np.linspace(-1.2, 1.2, PULSES), marks=pytest.mark.slow),
        1.6 * (np.arange(PULSES) < PULSES / 2),
    ],
)
def test_a_constant_that_changes_along_the_strip_is_told(tmp_path, late):
    """By a clock that drifts by 1 and 4 % each way, or in a file joined of two."""
    path = strip(tmp_path / "a.las", lambda t, a, rng: t - walk(a) + late + rng.normal(0.0, 0.05, len(t)))
    z, _, words, places = echoes(path)
    drift = places["vendor_offset"][0]["drift"]
    quarters = [np.median(part) for part in np.array_split(z, 4)]
    assert ("drift by" in words) == bool(drift) == bool(np.any(late)), words
    if drift:
        assert abs(drift) == pytest.approx(np.ptp([np.median(part) for part in np.array_split(late, 4)]), abs=0.2)
        assert np.sign(drift) == np.sign(late[0] - late[-1])
        assert np.ptp(quarters) == pytest.approx(abs(drift) * METRES_PER_NS, abs=0.01)
    else:
        assert np.ptp(quarters) < 0.01


def test_a_row_is_not_pulled_onto_its_return(tmp_path):
    """Vendor's locations scatter by 0.3 ns, 4.5 cm: the strip's curve is kept to, and the scatter stays out."""
    path = strip(tmp_path / "a.las", lambda t, a, rng: t - 1.0 + rng.normal(0.0, 0.2, len(t)))
    noisy, _, _, _ = echoes(path)
    assert 0.02 < np.std(noisy) < 0.04  # the return's own error, as its place is off by it; never 0 by construction


def test_locations_without_the_clocks_phase_place_every_pulse_by_its_return(tmp_path):
    path = strip(tmp_path / "a.las", lambda t, a, rng: t + rng.uniform(-0.5, 0.5, len(t)))
    z, _, words, places = echoes(path)
    assert places["vendor_offset"][0]["phase"] and "clock" in words
    assert (np.abs(z) < 0.002).mean() > 0.98
    free, _, _, _ = echoes(path, "decompose.register_within=0")
    assert 0.03 < np.std(free) < 0.06


@pytest.mark.parametrize("rule", [pytest.param(np.rint, marks=pytest.mark.slow), np.floor])
@pytest.mark.parametrize("rough", [0.0, 0.05])
def test_returns_that_stand_on_samples_with_their_places_pull_nothing(tmp_path, rule, rough):
    """The vendor's return is a sample, and so is its place: both are right together."""
    ground = np.random.default_rng(7).normal(0.0, rough, PULSES)
    off = []

    def location(time, height, rng):
        off.append(time - rule(time))
        return rule(time)

    def change(xyz):
        xyz[:, 2] += ground + off[0] * METRES_PER_NS

    z, _, words, places = echoes(strip(tmp_path / "a.las", location, change=change))
    assert not places["vendor_offset"][0]["phase"] and "clock" not in words and "vendor's locations" not in words
    assert np.std(z - ground) < 0.012 and abs(np.median(z - ground)) < 0.002


@pytest.mark.parametrize("rough", [0.0, 0.05])
def test_places_without_the_samples_of_their_returns_pull_rows(tmp_path, rough):
    ground = np.random.default_rng(7).normal(0.0, rough, PULSES)

    def change(xyz):
        xyz[:, 2] += ground

    z, _, _, places = echoes(strip(tmp_path / "a.las", lambda t, a, rng: np.rint(t), change=change))
    assert places["vendor_offset"][0]["phase"] and np.std(z - ground) < 0.002


@pytest.mark.parametrize("share", [0.0, 0.05, pytest.param(0.1, marks=pytest.mark.slow), 0.3])
def test_locations_that_are_a_sample_off_in_some_pulses_are_told(tmp_path, share):
    """The middle of all is right, and 0.15 m is not: nothing was said of it."""
    path = strip(tmp_path / "a.las", lambda t, a, rng: t - (rng.random(len(t)) < share))
    z, _, words, places = echoes(path)
    assert abs(places["vendor_offset"][0]["astray"] - share) < 0.05
    assert ("whole samples off the returns that place them" in words) == (share > 0.0)
    assert abs(places["vendor_offset"][0]["slipped"] - share) < 0.05
    assert abs((np.abs(z) > 0.1).mean() - share) < 0.05


def test_true_locations_change_nothing(tmp_path):
    path = strip(tmp_path / "a.las", lambda t, a, rng: t)
    z, _, words, places = echoes(path)
    assert "vendor's locations" not in words
    assert max(map(abs, places["vendor_offset"][0]["offsets"])) < 0.03
    assert np.std(z) < 0.02


def test_too_few_returns_show_nothing(tmp_path):
    path = strip(tmp_path / "a.las", lambda t, a, rng: t - 0.6, pulses=30)
    z, _, _, places = echoes(path)
    assert places["vendor_offset"] == [] and np.abs(z).max() < 0.002


def test_locations_that_make_no_sense_show_nothing(tmp_path):
    path = strip(tmp_path / "a.las", lambda t, a, rng: rng.uniform(0.0, 60.0, len(t)))
    assert echoes(path, "plausibility.accept=true")[3]["vendor_offset"] == []


def test_chunks_do_not_matter(tmp_path):
    """The curve is the strip's, whatever the file is cut into, and whatever share of it is looked at."""
    path = strip(tmp_path / "a.las", lambda t, a, rng: t - walk(a))
    for more in ((), ("pulse.sample=300",)):
        whole, parts = echoes(path, *more), echoes(path, "read.chunk_pulses=70", *more)
        np.testing.assert_array_equal(whole[0], parts[0])
        assert whole[3] == parts[3]


def test_the_report_names_the_strips():
    counts = dict.fromkeys(COUNTS, 0)
    channel = {"constant": 1.7, "offsets": [1.2, 1.9], "heights": [20.0, 110.0], "phase": False}
    strips = [
        strip_plausibility(
            f"s{k}", 10, counts, {"lag1": None, "inflation": 1.0}, {"vendor_offset": [channel], "outgoing_time": None}
        )
        for k in range(5)
    ]
    (line,) = plausibility_remarks(strips, conf.section("decompose"))
    assert (
        "+1.70 ns (0.25 m)" in line
        and "from 1.20 at 20 DN to 1.90 at 110 DN" in line
        and "s0, s1, s2 and 2 more" in line
    )


def line(path, origin, jitter=1.0, pulses=500, height=600.0, centre=0):
    """A scan line over a plane, in Pulse and Waves files whose outgoing pulse is up to `jitter` ns off its place.

    `origin`: what durations count from: the digitiser's ``trigger``; the outgoing ``pulse`` itself; the trigger, and
    the converter has moved the ``anchor`` instead; or the first sample, at whose place the anchor is (``sample``).
    """
    rng = np.random.default_rng(3)
    made, truth = [], []
    for p, tilt in enumerate(np.linspace(-0.25, 0.25, pulses)):
        sensor = np.array([500000.0, 5400000.0 + 0.02 * p, 200.0 + height])
        away = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
        late = rng.uniform(-jitter, jitter)
        ground = height / np.cos(tilt) / METRES_PER_NS
        outgoing = digitise(gaussian(24, [(180.0, 11.0 + late, 3.5)], 10.0) + rng.normal(0, 0.7, 24))
        begin = np.floor(ground - 20.0)
        y = gaussian(60, [(rng.uniform(60, 200), ground + late - begin, 3.7)], 10.0) + rng.normal(0, 0.7, 60)
        anchor, duration, launched = sensor, begin, -11.0
        if origin == "pulse":  # the sampling clock of the returns was set right; the record beside it is as it was
            y = gaussian(60, [(rng.uniform(60, 200), ground - begin, 3.7)], 10.0) + rng.normal(0, 0.7, 60)
        elif origin == "anchor":
            anchor = sensor - late * METRES_PER_NS * away
        elif origin == "sample":
            anchor, duration = sensor + (begin - late) * METRES_PER_NS * away, 0.0
            launched = 0.0
        waves = [[(launched, outgoing)], [(duration, digitise(y))]]
        made.append(Pulse(np.round(anchor, 3), away, waves, time=1000.0 + 1e-5 * p))
        truth.append(ground)
    kinds = [Sampling(OUTGOING, length_bits=0, samples=24, segment_bits=0, segments=1), Sampling()]
    return write_pls(path, made, {1: Descriptor(kinds, centre=centre)}), np.array(truth) * METRES_PER_NS


@pytest.mark.parametrize(
    ("origin", "taken", "ranges"),
    [("trigger", True, True), ("pulse", False, False), ("anchor", False, True), ("sample", False, False)],
)
def test_the_data_tell_whether_times_count_from_the_outgoing_pulse(tmp_path, origin, taken, ranges):
    path, away = line(tmp_path / "a.pls", origin, centre=FLUCTUATES if origin == "sample" else 0)
    z, _, words, places = echoes(path)
    told = places["outgoing_time"]
    assert (told["from_outgoing"], told["range_from_outgoing"], told["pulses"]) == (taken, ranges, 500)
    assert ("is taken off: places along" in words) == taken and "decompose.outgoing_time" in words
    assert ("no fixed distance" in words) == (origin == "sample")
    assert len(z) == 500 and np.abs(z).max() < 0.04 and abs(z.mean()) < 0.003
    if origin != "sample":
        las = laspy.read(path.with_suffix(".out.laz"))
        order = np.argsort(np.asarray(las.gps_time), kind="stable")
        np.testing.assert_allclose(np.asarray(las["range"])[order], away, atol=0.04)


@pytest.mark.parametrize(("way", "off"), [("subtract", False), ("keep", True)])
def test_the_user_has_the_last_word(tmp_path, way, off):
    path, _ = line(tmp_path / "a.pls", "trigger")
    z, _, words, _ = echoes(path, f"decompose.outgoing_time={way}")
    assert "the setting says so" in words
    assert (np.std(z) > 0.05) == off


def test_an_outgoing_pulse_that_does_not_wander_is_taken_off_by_the_formats_rule(tmp_path):
    path, _ = line(tmp_path / "a.pls", "trigger", jitter=0.0)
    z, _, words, places = echoes(path)
    assert places["outgoing_time"]["from_outgoing"] and "by the format's rule" in words
    assert np.abs(z).max() < 0.04


def test_outgoing_times_do_not_depend_on_chunks(tmp_path):
    path, _ = line(tmp_path / "a.pls", "trigger")
    whole, parts = echoes(path, "pulse.sample=200"), echoes(path, "pulse.sample=200", "read.chunk_pulses=37")
    np.testing.assert_array_equal(whole[0], parts[0])
    assert whole[3] == parts[3]


@pytest.mark.parametrize("begin", [None, -3.0])
def test_a_raw_tables_begin_is_when_the_light_passed(tmp_path, begin):
    """An outgoing pulse that lies 5 ns later by its own clock, or whose time nobody knows, moves no echo."""
    truth = scene(pulses=400)
    columns = truth.columns(at="sensor")
    pulse = np.rint(150 * np.exp(-0.5 * ((np.arange(20) - 8.0) / SIGMA) ** 2) + 12).astype(np.uint16)
    columns["outgoing"] = [pulse] * 400
    if begin is not None:
        columns["outgoing_begin_ns"] = np.full(400, begin)
    path = write_parquet(tmp_path / "a.parquet", columns, {"crs": "EPSG:32632", "spacing_ns": "1.0"})
    words, judged = decompose_file(path, tmp_path / "a.laz", (), True)
    las = laspy.read(tmp_path / "a.laz")
    order = np.argsort(np.asarray(las.gps_time), kind="stable")
    assert np.abs(np.median(np.asarray(las.z)[order] - truth.place[:, 2])) < 0.01
    told = judged["plausibility"]["places"]["outgoing_time"]
    if begin is None:
        assert told is None and "outgoing" not in words
    else:
        assert not told["from_outgoing"] and "is not taken off" in words and "it is +5.00 ns" in words


@pytest.mark.parametrize("digits", [9, 4])
def test_beam_vectors_of_few_digits_are_told(tmp_path, digits):
    """Four decimals of metres a nanosecond are 1 dm, 600 m from the sensor."""
    truth = scene(pulses=400)
    columns = truth.columns("ns", "sensor")
    columns |= {axis: np.round(columns[axis], digits) for axis in ("dx", "dy", "dz")}
    path = write_parquet(tmp_path / "a.parquet", columns, {"crs": "EPSG:25832", "spacing_ns": "1"})
    words, judged = decompose_file(path, tmp_path / "a.laz", (), True)
    las = laspy.read(tmp_path / "a.laz")
    off = np.linalg.norm(np.c_[las.x, las.y, las.z] - truth.place, axis=1)
    share = judged["plausibility"]["uneven_share"]
    assert ("beam vectors" in words) == (digits == 4), words
    assert (share > 0.3 and np.median(off) > 0.05) if digits == 4 else (share == 0.0 and np.median(off) < 0.01)


@pytest.mark.parametrize(
    "part",
    [
        slice(0),
        pytest.param(slice(PULSES // 2, None), marks=pytest.mark.slow),
        slice(None, None, 2),
        pytest.param(slice(None), marks=pytest.mark.slow),
    ],
)
def test_beam_vectors_longer_than_lights_way_are_told(tmp_path, part):
    """2 % too long, in none, half, every other or all of the pulses: 6 cm of two returns 3 m apart."""
    rng, n = np.random.default_rng(4), PULSES
    height, time = rng.uniform(60.0, 150.0, n), rng.uniform(20.0, 24.0, n)
    noise = rng.normal(0.0, 0.6, (n, 90))
    waves = [
        digitise(gaussian(90, [(a, t, 3.6), (a, t + 30.0, 3.6)], 10.0) + v)
        for a, t, v in zip(height, time, noise, strict=True)
    ]
    x, y = 500000.0 + 0.5 * (np.arange(n) % 30), 5400000.0 + 0.5 * (np.arange(n) // 30)
    first, last = np.c_[x, y, np.full(n, 204.0)], np.c_[x, y, np.full(n, 204.0 - 30.0 * METRES_PER_NS)]
    beam = np.tile([0.0, 0.0, METRES_PER_NS], (n, 1))
    beam[part] *= 1.02
    path = write_las(
        tmp_path / "a.las",
        np.stack([first, last], axis=1).reshape(-1, 3),
        waveforms=waves,
        pulse=np.repeat(np.arange(n), 2),
        location=np.stack([time, time + 30.0], axis=1).ravel(),
        gps_time=1000.0 + 1e-5 * np.repeat(np.arange(n), 2),
        step=np.repeat(beam, 2, axis=0),
        return_number=np.tile([1, 2], n),
        number_of_returns=2,
        descriptors={1: _samples(90)},
    )
    words, judged = decompose_file(path, tmp_path / "a.laz", (), True)
    facts = judged["plausibility"]
    assert ("beam vectors" in words) == (part != slice(0)), words
    assert facts["uneven_share"] == 0.0 if part == slice(0) else facts["uneven_share"] > 0.15


def in_turn(samples, gain: float, joined: bool) -> None:
    """Every other pulse `gain` times as high; from the middle on the others, in a file `joined` of two."""
    level, half = 12.0, len(samples) // 2
    samples[1:half:2] = level + gain * (samples[1:half:2] - level)
    samples[half + (not joined) :: 2] = level + gain * (samples[half + (not joined) :: 2] - level)


@pytest.mark.parametrize(
    ("gain", "joined"), [pytest.param(1.0, False, marks=pytest.mark.slow), (1.1, False), (1.2, True)]
)
def test_pulses_in_turn_whose_heights_differ_are_told(tmp_path, gain, joined):
    truth = scene(pulses=1500)
    samples = np.rint(truth.samples.astype(float))
    in_turn(samples, gain, joined)
    truth.samples = np.rint(samples).clip(0, 255).astype(np.uint16)
    path = write_parquet(tmp_path / "a.parquet", truth.columns(), {"crs": "EPSG:25832", "spacing_ns": "1"})
    words, judged = decompose_file(path, tmp_path / "a.laz", (), True)
    assert ("every other pulse" in words) == (gain != 1.0), words
    told = judged["plausibility"]["places"]["alternate"]
    assert max(told, 1.0 / told) == pytest.approx(gain, abs=0.06)


@pytest.mark.parametrize("chosen", ["alike", "at random", "by height"])
def test_descriptors_whose_heights_differ_are_told(tmp_path, chosen):
    """One receiver of another gain, here and there, but not one that takes over where echoes are high."""
    rng, n = np.random.default_rng(4), PULSES
    ground = 90.0 + 30.0 * np.sin(np.arange(n) / 40.0)
    time = rng.uniform(20.0, 24.0, n)
    other = ground > 90.0 if chosen == "by height" else rng.random(n) < 0.5
    height = ground * rng.uniform(0.9, 1.1, n) * np.where(other & (chosen != "alike"), 1.2, 1.0)
    noise = rng.normal(0.0, 0.7, (n, 60))
    path = write_las(
        tmp_path / "a.las",
        np.c_[500000.0 + 0.5 * (np.arange(n) % 30), 5400000.0 + 0.5 * (np.arange(n) // 30), np.full(n, 200.0)],
        waveforms=[
            digitise(gaussian(60, [(a, t, 3.6)], 10.0) + v) for a, t, v in zip(height, time, noise, strict=True)
        ],
        pulse=np.arange(n),
        location=time,
        gps_time=1000.0 + 1e-5 * np.arange(n),
        descriptor_of=np.where(other, 2, 1),
        descriptors={1: _samples(60), 2: _samples(60)},
    )
    words, judged = decompose_file(path, tmp_path / "a.laz", (), True)
    assert ("of waveform descriptor" in words) == (chosen == "at random"), words
    told = judged["plausibility"]["places"]["descriptors"]
    if chosen == "at random":
        assert max(told[0][1], 1.0 / told[0][1]) == pytest.approx(1.2, abs=0.02)
    else:
        assert told == []
