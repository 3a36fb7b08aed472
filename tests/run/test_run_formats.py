"""Whole runs over files of every waveform format, and over damaged ones: nothing is lost, everything is counted."""

import contextlib
import struct

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from lasmaker import Descriptor, survey, to_laz

from fwclass import conf
from fwclass.errors import InputError
from fwclass.read.source import open_source
from fwclass.read.spans import Span
from fwclass.read.stage import read_span
from fwclass.run.local import Loop
from fwclass.run.progress import Display
from fwclass.run.runner import Runner
from fwclass.workflows import WORKFLOWS

CONFIG = """
survey:
  name: t
  directory: .
  sources: [{name}]
  reference: {{kind: source}}
  features: [height_above_ground, zc, amplitude]
  classes: [{{name: ground, code: 2, codes: [2]}}, {{name: vegetation, code: 5, codes: [3, 4, 5]}}]
areas: {{train: [[499000, 5390000, 500005.0, 5410000]], gap: 0.1}}
train: {{trees: 3}}
publish: {{figure_pixels: 200}}
"""


def run(directory, name, *settings):
    path = directory / "c.yaml"
    path.write_text(CONFIG.format(name=name))
    config = conf.load(path, settings)
    with Display() as display, contextlib.nullcontext(Loop()) as loop:
        runner = Runner(directory / "run", loop, display)
        report = WORKFLOWS["classification"](config, runner, None)
        runner.publish(config.run.keep_generations)
    assert not runner.failures, runner.failures
    return report


_OTHERS = (
    (4, "internal"),
    (4, "external"),
    (5, "internal"),
    (5, "external"),
    (9, "internal"),
    (9, "external"),
    (10, "external"),
)
"""Formats and places of waveforms in the pairs that are tested in the slow suite alone."""


def samples(path, points):
    """All waveforms of a file, by the reader."""
    source = open_source(path)
    waves = read_span(source, Span(0, points, 0, points), conf.section("read"))
    return waves.samples, waves.offsets


@pytest.mark.parametrize(
    ("point_format", "where"), [(10, "internal"), *(pytest.param(*other, marks=pytest.mark.slow) for other in _OTHERS)]
)
def test_every_waveform_format_goes_the_whole_road(tmp_path, point_format, where):
    bits = 16 if point_format in (5, 10) else 8
    truth = survey(tmp_path / "a.las", 400, point_format=point_format, where=where, bits=bits)
    report = run(tmp_path, "a.las")
    assert report["counts"]["pulses"] == 400
    assert report["counts"]["returns_without_packet"] == 0 and not report["input"]["faults"]
    assert report["counts"]["echoes_in_tiles"] == report["counts"]["echoes_decomposed"]
    assert abs(report["counts"]["echoes_in_tiles"] - len(truth.pulse)) <= 0.02 * len(truth.pulse)
    source, strip = laspy.read(tmp_path / "a.las"), laspy.read(tmp_path / "run" / "laz" / "strips" / "a.laz")
    for name in source.point_format.dimension_names:
        if name != "classification":
            np.testing.assert_array_equal(source[name], strip[name], err_msg=name)
    assert (np.asarray(strip.classification) == np.asarray(source.classification)).mean() > 0.9
    before, after = samples(tmp_path / "a.las", len(source)), samples(tmp_path / "run/laz/strips/a.laz", len(source))
    np.testing.assert_array_equal(before[0], after[0])
    np.testing.assert_array_equal(before[1], after[1])
    assert len(before[1]) == 401


@pytest.mark.slow
def test_point_source_ids_join_tiles_to_strips(tmp_path):
    """Whatever the files are called: tiles, strips, GeoParquet and report.json mean the same file by a number."""
    names = ("strip_07", "line_1203", "b", "a", "strip_01")
    for k, name in enumerate(names):
        survey(tmp_path / f"{name}.las", 40 + 10 * k, seed=k)
    report = run(tmp_path, "'*.las'")
    numbers = {file["path"].removesuffix(".las"): file["strip"] for file in report["input"]["files"]}
    assert numbers["strip_07"] == 7 and numbers["strip_01"] == 1 and len(set(numbers.values())) == len(names)
    tiles = [laspy.read(path) for path in (tmp_path / "run" / "laz" / "tiles").glob("*.laz")]
    ids = np.concatenate([np.asarray(tile.point_source_id) for tile in tiles])
    pulses = np.concatenate([np.asarray(tile.gps_time) for tile in tiles])
    for k, name in enumerate(names):
        strip = laspy.read(tmp_path / "run" / "laz" / "strips" / f"{name}.laz")
        assert len(np.unique(pulses[ids == numbers[name]])) == len(np.unique(strip.gps_time)) == 40 + 10 * k
    tables = [pq.read_table(path, columns=["strip"]) for path in (tmp_path / "run" / "parquet").rglob("*.parquet")]
    assert np.array_equal(np.sort(np.concatenate([t["strip"].to_numpy() for t in tables])), np.sort(ids))


@pytest.mark.slow
def test_laz_in_gives_the_same_echoes_as_las(tmp_path):
    survey(tmp_path / "a.las", 300, point_format=9)
    first = run(tmp_path, "a.las")
    (tmp_path / "b").mkdir()
    to_laz(tmp_path / "a.las", tmp_path / "b" / "a.laz")
    (tmp_path / "b" / "a.wdp").write_bytes((tmp_path / "a.wdp").read_bytes())
    second = run(tmp_path / "b", "a.laz")
    assert first["accuracy"] == second["accuracy"] and first["counts"] == second["counts"]


FAULTS = {
    "packet past the end": {"wave": {"offset": 10**9}},
    "unknown descriptor": {"wave": {"index": 77}},
    "compressed": {"descriptors": {1: Descriptor(compression=2)}},
}


@pytest.mark.parametrize("fault", ["compressed", *(pytest.param(f, marks=pytest.mark.slow) for f in list(FAULTS)[:2])])
def test_a_file_without_any_usable_packet_is_refused_or_kept_as_asked(tmp_path, fault):
    survey(tmp_path / "a.las", 200, **FAULTS[fault])
    with pytest.raises(InputError, match=r"none can be read[\s\S]*missing_packets=keep"):
        run(tmp_path, "a.las")
    report = run(tmp_path, "a.las", "read.missing_packets=keep")
    counts = report["counts"]
    assert counts["returns_without_packet"] == counts["echoes_in_tiles"] == counts["returns"] > 200
    assert sum(report["input"]["faults"].values()) == counts["returns"]


def test_some_bad_packets_cost_only_their_own_waveforms(tmp_path):
    truth = survey(tmp_path / "a.las", 300)
    offsets = laspy.read(tmp_path / "a.las")["wavepacket_offset"].copy()
    bad = truth.pulse % 10 == 0
    offsets[bad] += 10**8
    survey(tmp_path / "a.las", 300, wave={"offset": offsets})
    report = run(tmp_path, "a.las")
    assert report["counts"]["returns_without_packet"] == bad.sum()
    assert report["input"]["faults"] == {"packet past the end": int(bad.sum())}
    strip = laspy.read(tmp_path / "run" / "laz" / "strips" / "a.laz")
    assert len(strip) == len(truth.pulse) and set(np.unique(strip.classification)) <= {2, 5}


def test_a_missing_and_a_cut_wdp(tmp_path):
    survey(tmp_path / "a.las", 200)
    whole = (tmp_path / "a.wdp").read_bytes()
    (tmp_path / "a.wdp").write_bytes(whole[: len(whole) // 2])
    report = run(tmp_path, "a.las")
    assert 0 < report["counts"]["returns_without_packet"] < report["counts"]["returns"]
    (tmp_path / "a.wdp").unlink()
    with pytest.raises(InputError, match=r"a\.wdp"):
        run(tmp_path, "a.las")


def test_a_file_without_points_beside_a_good_one(tmp_path):
    survey(tmp_path / "a.las", 200)
    data = bytearray((tmp_path / "a.las").read_bytes())
    start = struct.unpack_from("<I", data, 96)[0]
    struct.pack_into("<I", data, 107, 0)
    struct.pack_into("<Q", data, 247, 0)
    (tmp_path / "b.las").write_bytes(data[:start])
    (tmp_path / "b.wdp").write_bytes((tmp_path / "a.wdp").read_bytes())
    report = run(tmp_path, "'*.las'")
    assert [f["points"] for f in report["input"]["files"]] == [report["counts"]["returns"], 0]
    with pytest.raises(InputError, match="no points"):
        run(tmp_path, "b.las")


def test_tiles_without_ground_are_ordinary(tmp_path):
    """Echoes far above any terrain support: no height above ground, still classified."""
    survey(tmp_path / "a.las", 400)
    report = run(tmp_path, "a.las", "terrain.max_gap=0", "ground.smrf.slope=0")
    assert report["counts"]["echoes_in_tiles"] > 400
    assert report["accuracy"]["overall_accuracy"] is not None
