"""LVIS and GEDI L1B, written here by h5py: ground at its height and place, and words for what is wrong."""

from __future__ import annotations

import json
import os
import zlib

import laspy
import numpy as np
import pytest
from commandline import fwclass
from pyproj import Transformer

from fwclass.errors import InputError
from fwclass.read import footprints, hdf5_arrays
from fwclass.read.info import info

h5py = pytest.importorskip("h5py")

HALF_LIGHT = 0.299792458 / 2.0 / 1.000273
SIGMA = 8.0 / 2.354820045
BEND = 0.15
"""Metres: a standard error of 1 cm, the scale of the plane, and half a step of the stored degrees."""


def shots(n=300, samples=400, tilt=3.0, seed=5):
    """Places of first and last samples [degrees, m], waveforms, and where the ground is (UTM 18)."""
    r = np.random.default_rng(seed)
    x, y = 350_000.0 + 12.0 * np.arange(n), 4_310_000.0 + r.uniform(0, 500, n)
    ground = np.stack([x, y, 200.0 + 0.02 * (x - x[0])], axis=1)
    lean = np.radians(tilt)
    up = np.array([np.sin(lean), 0.0, np.cos(lean)])
    at = r.uniform(250.0, 260.0, n)
    first = ground + (at * HALF_LIGHT)[:, None] * up
    end = ground - ((samples - 1 - at) * HALF_LIGHT)[:, None] * up
    t = np.arange(samples)
    height = r.uniform(150, 400, n)[:, None]
    wave = 240.0 + r.normal(0, 3.0, (n, samples)) + height * np.exp(-0.5 * ((t - at[:, None]) / SIGMA) ** 2)
    back = Transformer.from_crs(32618, 4326, always_xy=True)
    geo = [np.stack([*back.transform(p[:, 0], p[:, 1]), p[:, 2]], axis=1) for p in (first, end)]
    return geo[0], geo[1], wave, ground, np.exp(-0.5 * ((np.arange(120) - 60) / SIGMA) ** 2) * 300.0 + 20


def lvis(path, n=300, **more):
    first, end, wave, ground, pulse = shots(n, **more)
    last = wave.shape[1] - 1
    with h5py.File(path, "w") as f:
        for k, axis in enumerate(("LON", "LAT", "Z")):
            around = 360.0 if k == 0 else 0.0  # LVIS counts longitudes to 360
            f[f"{axis}0"], f[f"{axis}{last}"] = first[:, k] + around, end[:, k] + around
        f["RXWAVE"] = np.rint(wave).astype(">u2")
        f["TXWAVE"] = np.tile(np.rint(pulse), (n, 1)).astype(">u2")
        f["TIME"] = 50_000.0 + np.arange(n) * 0.01
    return ground


def gedi(path, n=300):
    first, end, wave, ground, pulse = shots(n)
    with h5py.File(path, "w") as f:
        for name, rows in (("BEAM0000", slice(0, n // 2)), ("BEAM0101", slice(n // 2, n))):
            g, part = f.create_group(name), wave[rows]
            m = len(part)
            g["rxwaveform"] = part.reshape(-1).astype("f4")
            g["rx_sample_start_index"] = 1 + np.arange(m, dtype="u8") * wave.shape[1]
            g["rx_sample_count"] = np.full(m, wave.shape[1], "u2")
            g["txwaveform"] = np.tile(pulse, m).astype("f4")
            g["tx_sample_start_index"] = 1 + np.arange(m, dtype="u8") * 120
            g["tx_sample_count"] = np.full(m, 120, "u2")
            g["delta_time"] = 50_000.0 + np.arange(n)[rows] * 0.01
            g["stale_return_flag"] = np.zeros(m, "u1")
            g["noise_stddev_corrected"] = np.full(m, 3.0, "f4")
            for k, axis in enumerate(("longitude", "latitude", "elevation")):
                g[f"geolocation/{axis}_bin0"], g[f"geolocation/{axis}_lastbin"] = first[rows, k], end[rows, k]
    return ground


@pytest.mark.parametrize("write", [lvis, gedi])
def test_ground_is_where_it_is(tmp_path, write):
    path = tmp_path / "a.h5"
    ground = write(path)
    ended = fwclass("decompose", path, tmp_path / "o.laz")
    assert ended.returncode == 0, ended.stderr
    las = laspy.read(tmp_path / "o.laz")
    row = np.rint((np.asarray(las.gps_time) - 50_000.0) / 0.01).astype(int)
    off = np.abs(np.stack([las.x, las.y, las.z], axis=1) - ground[row])
    assert len(set(row)) == 300 and np.quantile(off, 0.99) < BEND, np.quantile(off, [0.5, 0.9, 0.99])
    assert las.header.parse_crs().to_epsg() == 32618
    found = json.loads(fwclass("info", path, "--json").stdout)
    assert found["format"].endswith("L1B") and found["pulses"] == 300 == found["outgoing"]
    assert found["waveforms"]["spacing_ns"] == [1.0, 1.0] and not found["faults"]
    assert "UTM zone 18N" in fwclass("info", path).stdout
    if write is gedi:  # by then both are the same waveforms
        assert fwclass("info", "--waveforms", path, "--out", tmp_path / "a.png").returncode == 0
    other = fwclass("decompose", path, tmp_path / "p.laz", "--crs", "EPSG:25832")
    assert other.returncode == 1 and "zone of its shots" in other.stderr


def drop(name):
    def change(f):
        del f[name]

    return change


def put(name, values):
    def change(f):
        del f[name]
        f[name] = values

    return change


def scaled(factor, *names):
    """All places of these axes in another unit."""

    def change(f):
        for name in [n for n in f if n.startswith(names)]:
            values = f[name][:]
            del f[name]
            f[name] = ((values + 180.0) % 360.0 - 180.0) * factor if name.startswith("LON") else values * factor

    return change


@pytest.mark.parametrize(
    ("write", "change", "words"),
    [
        (lvis, scaled(3.28084, "Z"), "do not fit their number"),
        (lvis, scaled(np.pi / 180.0, "LON", "LAT"), "look like radians"),
        (lvis, drop("LAT0"), "missing"),
        (lvis, put("Z0", np.zeros(7)), "equally long"),
        (lvis, put("Z0", np.full(300, np.nan)), "no waveform"),
        (lvis, put("RXWAVE", np.zeros((300, 17), "u2")), "last sample"),
        (lvis, put("LON0", np.linspace(0, 90, 300)), "too far apart"),
        (lvis, put("RXWAVE", [b"a"] * 300), "no array"),
        (gedi, drop("BEAM0000/geolocation"), "missing"),
        (gedi, put("BEAM0000/rx_sample_count", np.full(150, 60_000, "u2")), "overlap|no waveform"),
        (gedi, put("BEAM0000/rx_sample_start_index", np.ones(4, "u8")), "equally long"),
    ],
)
def test_damage_is_told(tmp_path, write, change, words):
    path = tmp_path / "a.h5"
    write(path)
    with h5py.File(path, "a") as f:
        change(f)
    ended = fwclass("decompose", path, tmp_path / "o.laz")
    if words.startswith("overlap") and ended.returncode == 0:  # the shots of the other beam are sound
        assert "no samples" in ended.stdout + ended.stderr
        return
    assert ended.returncode == 1 and any(w in ended.stderr for w in words.split("|")), ended.stderr


def test_cut_short_no_shot_and_forged_size(tmp_path):
    path = tmp_path / "a.h5"
    lvis(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    ended = fwclass("info", path)
    assert ended.returncode == 1 and "cut short" in ended.stderr
    lvis(path, n=1)
    assert fwclass("decompose", path, tmp_path / "o.laz").returncode == 0
    with h5py.File(path, "w") as f:
        for name in ("LON0", "LAT0", "Z0", "LON9", "LAT9", "Z9"):
            f[name] = np.empty(0)
        f["RXWAVE"] = np.empty((0, 10), "u2")
    assert fwclass("info", path).returncode == 0
    with h5py.File(path, "w") as f:
        f.create_dataset("RXWAVE", (10**9, 10), "u2", chunks=(1000, 10))
        for name in ("LON0", "LAT0", "Z0", "LON9", "LAT9", "Z9"):
            f.create_dataset(name, (10**9,), "f8", chunks=(1000,))
    ended = fwclass("info", path)
    assert ended.returncode == 1 and "more than the file can hold" in ended.stderr


def of_other_files(f):
    """A column that grows with a pipe's."""
    layout = h5py.VirtualLayout(shape=(300,), dtype="f8", maxshape=(None,))
    source = h5py.VirtualSource("pipe", "Z0", shape=(300,), maxshape=(None,))
    layout[0 : h5py.h5s.UNLIMITED] = source[0 : h5py.h5s.UNLIMITED]
    del f["Z0"]
    f.create_virtual_dataset("Z0", layout)


def packed_twice(f):
    """A chunk of 16 MB, of 150 bytes."""
    made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    made.set_chunk((300, 400))
    for _ in range(2):
        made.set_filter(h5py.h5z.FILTER_DEFLATE, 0, (9,))
    del f["RXWAVE"]
    h5py.h5d.create(f.id, b"RXWAVE", h5py.h5t.STD_U16LE, h5py.h5s.create_simple((300, 400)), made)
    packing = zlib.compressobj(9)
    once = b"".join(packing.compress(bytes(1 << 20)) for _ in range(16)) + packing.flush()
    f["RXWAVE"].id.write_direct_chunk((0, 0), zlib.compress(once, 9), 0)


def swelling(f):
    """A chunk of 8 bytes a shot that unpacks to a gigabyte, of 1 MB."""
    made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    made.set_chunk((300,))
    made.set_filter(h5py.h5z.FILTER_DEFLATE, 0, (9,))
    del f["TIME"]
    h5py.h5d.create(f.id, b"TIME", h5py.h5t.IEEE_F64LE, h5py.h5s.create_simple((300,)), made)
    packing, zeros = zlib.compressobj(9, wbits=-15), bytes(1 << 20)
    one = packing.compress(zeros) + packing.flush(zlib.Z_FULL_FLUSH)  # which stands for itself wherever it is put
    check = (1024 * len(zeros) % 65521) << 16 | 1  # Adler's, of nothing but zeros
    f["TIME"].id.write_direct_chunk((0,), b"\x78\xda" + 1024 * one + packing.flush() + check.to_bytes(4, "big"))


def chunk_of_all(f):
    """A chunk that is unpacked for every block of shots."""
    size = hdf5_arrays.CHUNK + 1
    del f["TIME"]
    f.create_dataset("TIME", (300,), "i1", chunks=(size,), maxshape=(None,), compression="gzip")


def other_order(f):
    group = f["BEAM0101"]
    group["rx_sample_start_index"][...] = group["rx_sample_start_index"][...][::-1]


@pytest.mark.parametrize(
    ("write", "change", "words"),
    [
        (lvis, put("Z0", h5py.ExternalLink("pipe", "/Z0")), "a link leads elsewhere"),
        (gedi, put("BEAM0000", h5py.ExternalLink("pipe", "/BEAM0000")), "a link leads elsewhere"),
        (gedi, put("BEAM0000", h5py.ExternalLink("other.h5", "/BEAM0000")), "a link leads elsewhere"),
        (gedi, put("BEAM0000/geolocation", h5py.SoftLink("/BEAM0000/geolocation")), "a link leads elsewhere"),
        (lvis, of_other_files, "a data set of other files"),
        (lvis, packed_twice, "packed in another way"),
        (lvis, swelling, "counts more than the file can hold"),
        (lvis, chunk_of_all, "chunks of a data set are too large"),
        (gedi, other_order, "another order than the shots"),
    ],
)
def test_what_leads_elsewhere_or_swells_is_refused(tmp_path, write, change, words):
    """A pipe that HDF5 opened would keep the command waiting for ever."""
    os.mkfifo(tmp_path / "pipe")
    write(tmp_path / "other.h5")
    path = tmp_path / "a.h5"
    write(path)
    with h5py.File(path, "a") as f:
        change(f)
    with pytest.raises(InputError, match=words):
        info(path)


def test_shots_of_no_bytes_are_refused(tmp_path):
    n = 200_000
    with h5py.File(tmp_path / "a.h5", "w") as f:
        for name in ("LON0", "LAT0", "Z0", "LON9", "LAT9", "Z9"):
            f.create_dataset(name, data=np.zeros(n), compression="gzip")
        f.create_dataset("RXWAVE", data=np.zeros((n, 10), "u1"), compression="gzip")
    with pytest.raises(InputError, match="counts more than the file can hold"):
        info(tmp_path / "a.h5")


def test_shots_with_wide_gaps_between_their_samples(tmp_path, monkeypatch):
    """As where an area was cut out and the samples of all were kept."""
    gedi(tmp_path / "a.h5")
    monkeypatch.setattr(footprints, "GAP", 100)
    with h5py.File(tmp_path / "a.h5", "a") as f:
        group = f["BEAM0000"]
        for name in [n for n in group if n != "geolocation" and not n.startswith("rxwave") and len(group[n]) == 150]:
            values = group[name][...][::7]
            del group[name]
            group[name] = values
        for name in list(group["geolocation"]):
            values = group["geolocation"][name][...][::7]
            del group["geolocation"][name]
            group["geolocation"][name] = values
        wave, start, count = (group[n][...] for n in ("rxwaveform", "rx_sample_start_index", "rx_sample_count"))
    layout = footprints.open_footprints(tmp_path / "a.h5")[0]
    rows = layout.read(0, len(start))
    for k in range(len(start)):
        first = int(start[k]) - 1
        there = rows.samples.values[rows.samples.offsets[k] : rows.samples.offsets[k + 1]]
        assert np.array_equal(there, wave[first : first + int(count[k])])


def test_without_h5py(tmp_path, monkeypatch):
    lvis(tmp_path / "a.h5", n=3)
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    ended = fwclass("info", tmp_path / "a.h5")
    assert ended.returncode == 1 and "fwclass[hdf5]" in ended.stderr
