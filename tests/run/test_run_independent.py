"""Statistics of decomposition through the command line: a survey written byte by byte, and scored, without the program.

Nothing of fwclass or of the suite's makers is imported: struct and numpy write LAS 1.3, point format 4, with packets in
a .wdp file; laspy reads what comes out.
"""

import struct
import subprocess
import sys

import laspy
import numpy as np
import pytest

WIDTH = 4.2
SIGMA = WIDTH / 2.354820045
SAMPLES, NOISE, LEVEL = 80, 1.4, 12.0
METRES = 0.299792458 / 2.0 / 1.000273
BEAM = np.array([0.12, -0.05, -1.0]) / np.sqrt(1.0 + 0.12**2 + 0.05**2)
PULSES = 6000


def truth(rng):
    """Row, time [ns], height [DN] and sigma [ns] of every echo: two thirds of the pulses have one, the others two."""
    second = rng.random(PULSES) < 1.0 / 3.0
    first_time = rng.uniform(18.0, 30.0, PULSES)
    height = np.exp(rng.uniform(np.log(30.0), np.log(180.0), (PULSES, 2)))
    sigma = SIGMA * rng.uniform(1.0, 1.5, (PULSES, 2))
    gap = rng.uniform(9.0, 30.0, PULSES)
    row = np.concatenate([np.arange(PULSES), np.flatnonzero(second)])
    time = np.concatenate([first_time, (first_time + gap)[second]])
    order = np.lexsort((time, row))
    return (
        row[order],
        time[order],
        np.concatenate([height[:, 0], height[second, 1]])[order],
        np.concatenate([sigma[:, 0], sigma[second, 1]])[order],
    )


def write(directory, seed):
    """`a.las` and `a.wdp`; returns the truth and the place of every echo (n, 3)."""
    rng = np.random.default_rng(seed)
    row, time, height, sigma = truth(rng)
    t = np.arange(SAMPLES)
    signal = np.zeros((PULSES, SAMPLES))
    np.add.at(signal, row, height[:, None] * np.exp(-0.5 * ((t - time[:, None]) / sigma[:, None]) ** 2))
    recorded = np.clip(np.rint(signal + LEVEL + NOISE * rng.standard_normal(signal.shape)), 0, 255).astype(np.uint8)
    side = 80
    start = np.c_[
        600_000.0 + 0.5 * (np.arange(PULSES) % side),
        5_400_000.0 + 0.5 * (np.arange(PULSES) // side),
        np.full(PULSES, 420.0),
    ]
    place = start[row] + (time * METRES)[:, None] * BEAM
    number = np.arange(len(row)) - np.searchsorted(row, row) + 1
    many = np.bincount(row)[row]
    whole = np.rint((place - (600_000.0, 5_400_000.0, 0.0)) * 1000.0).astype(int)
    places = whole / 1000.0 + (600_000.0, 5_400_000.0, 0.0)
    stored = (-BEAM * METRES / 1000.0).tolist()
    points = b"".join(
        struct.pack(
            "<iiiHBBbBHd",
            *whole[i].tolist(),
            int(height[i]),
            int(number[i] | many[i] << 3),
            *(1, 0, 0, 1),
            1e5 + 1e-5 * row[i],
        )
        + struct.pack("<BQIffff", 1, 60 + SAMPLES * int(row[i]), SAMPLES, 1000.0 * time[i], *stored)
        for i in range(len(row))
    )
    vlr = struct.pack("<H16sHH32s", 0, b"LASF_Spec", 100, 26, b"") + struct.pack(
        "<BBIIdd", 8, 0, SAMPLES, 1000, 1.0, 0.0
    )
    low, high = places.min(axis=0), places.max(axis=0)
    counts = np.bincount(number, minlength=6)[1:6]
    header = struct.pack(
        "<4sHHIHH8sBB32s32sHHHIIBHI5I3d3d6dQ",
        b"LASF",
        0,
        4,
        0,
        0,
        0,
        b"",
        1,
        3,
        b"by hand",
        b"numpy",
        1,
        2020,
        235,
        235 + len(vlr),
        1,
        4,
        57,
        len(row),
        *counts.tolist(),
        0.001,
        0.001,
        0.001,
        600_000.0,
        5_400_000.0,
        0.0,
        *(v for pair in zip(high, low, strict=True) for v in pair),
        0,
    )
    (directory / "a.las").write_bytes(header + vlr + points)
    extended = struct.pack("<H16sHQ32s", 0, b"LASF_Spec", 65535, recorded.nbytes, b"")
    (directory / "a.wdp").write_bytes(extended + recorded.tobytes())
    return (row, time, height, sigma), places


@pytest.fixture(scope="module")
def scored(tmp_path_factory):
    directory = tmp_path_factory.mktemp("independent")
    true, places = write(directory, 7)
    line = [
        sys.executable,
        "-m",
        "fwclass",
        "decompose",
        str(directory / "a.las"),
        str(directory / "out.laz"),
        "--crs",
        "EPSG:25832",
    ]
    ended = subprocess.run(line, capture_output=True, text=True, timeout=600, cwd=directory)
    assert ended.returncode == 0, ended.stderr
    out = laspy.read(directory / "out.laz")
    pulse = np.rint((np.asarray(out.gps_time) - 1e5) * 1e5).astype(int)
    found = {
        n: np.asarray(out[n], float)
        for n in ("echo time", "amplitude DN", "echo width", "amplitude sigma", "width sigma", "range sigma")
    }
    return true, places, pulse, found, np.c_[out.x, out.y, out.z]


def pairs(scored):
    """Nearest found echo of the same pulse for every true one, within half a pulse; each once."""
    (row, time, _, _), _, pulse, found, _ = scored
    order = np.lexsort((found["echo time"], pulse))
    matched, used = np.full(len(row), -1), np.zeros(len(pulse), bool)
    begin, end = np.searchsorted(pulse[order], row), np.searchsorted(pulse[order], row, side="right")
    for i in range(len(row)):
        free = [k for k in order[begin[i] : end[i]] if not used[k] and abs(found["echo time"][k] - time[i]) < WIDTH / 2]
        if free:
            matched[i] = min(free, key=lambda k: abs(found["echo time"][k] - time[i]))
            used[matched[i]] = True
    return matched, used


def test_every_echo_is_there_and_hardly_any_more(scored):
    (_row, _, _, _), _, _pulse, _, _ = scored
    matched, used = pairs(scored)
    assert (matched >= 0).mean() > 0.998
    assert (~used).sum() <= 0.004 * PULSES


def test_standard_errors_hold(scored):
    (row, time, height, sigma), _, pulse, found, _ = scored
    matched, _ = pairs(scored)
    right = np.bincount(pulse, minlength=PULSES)[row] == np.bincount(row, minlength=PULSES)[row]
    use = (matched >= 0) & right & (height + LEVEL < 235.0)
    k, n = matched[use], int(use.sum())
    off = {
        "amplitude": (found["amplitude DN"][k] - height[use]) / found["amplitude sigma"][k],
        "time": (found["echo time"][k] - time[use]) * METRES / found["range sigma"][k],
        "width": (found["echo width"][k] - 2.354820045 * sigma[use]) / found["width sigma"][k],
    }
    slack = 3.0 / np.sqrt(2.0 * n)
    for name, standard in off.items():
        assert abs(np.sqrt(np.mean(standard**2)) - 1.0) < 0.04 + slack, (name, np.sqrt(np.mean(standard**2)))
        assert abs(np.mean(standard)) < 0.15, (name, np.mean(standard))


def test_times_reach_the_bound(scored):
    """Root mean square over the Cramer-Rao bound of one echo with its level free; single echoes alone."""
    (row, time, height, sigma), _, pulse, found, _ = scored
    matched, _ = pairs(scored)
    single = (np.bincount(row, minlength=PULSES) == 1)[row] & (matched >= 0) & (height + LEVEL < 235.0)
    single &= np.bincount(pulse, minlength=PULSES)[row] == 1
    t, ratio = np.arange(SAMPLES), []
    for i in np.flatnonzero(single)[:1500]:
        d = (t - time[i]) / sigma[i]
        h = np.exp(-0.5 * d * d)
        slopes = np.stack([np.ones(SAMPLES), h, height[i] * h * d / sigma[i], height[i] * h * d * d / sigma[i]])
        bound = np.sqrt(np.linalg.inv(slopes @ slopes.T / (NOISE**2 + 1.0 / 12.0))[2, 2])
        ratio.append((found["echo time"][matched[i]] - time[i]) / bound)
    assert 0.93 < np.sqrt(np.mean(np.square(ratio))) < 1.06


def test_places_are_those_of_the_light(scored):
    (_, _, height, _), places, _, _, out = scored
    matched, _ = pairs(scored)
    bright = (matched >= 0) & (height > 100.0) & (height + LEVEL < 235.0)
    off = np.linalg.norm(out[matched[bright]] - places[bright], axis=1)
    assert np.median(off) < 0.006 and np.percentile(off, 95) < 0.03
