"""Echoes that cannot be are counted, told, kept from the terrain, and end a command unless the user accepts them."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from commandline import fwclass
from lasmaker import flat_survey, survey
from plsmaker import survey as pulsewaves

REAL = Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "waveform"
CONFIG = """
survey:
  name: t
  directory: .
  sources: ["*.las"]
  reference: {kind: source}
  features: [height_above_ground, zc, amplitude]
  classes: [{name: ground, code: 2, codes: [2]}, {name: vegetation, code: 5, codes: [1, 3, 4, 5]}]
areas: {train: [[499000, 5390000, 500008.0, 5410000]], gap: 0.1}
train: {trees: 3}
publish: {figure_pixels: 200}
"""


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    """Flat ground at 265 m by a receiver whose noise hangs together, as a Leica's does."""
    return flat_survey(tmp_path_factory.mktemp("noisy") / "strip_01.las", 900, 0.6, wander=0.8)


@pytest.fixture(scope="module")
def haunted(tmp_path_factory):
    """Flat ground at 265 m by a receiver that shows three of ten echoes again, 15 m below."""
    return flat_survey(tmp_path_factory.mktemp("haunted") / "strip_01.las", 900, 0.6, ghosts=0.3)


def test_a_receiver_with_correlated_noise_gets_no_false_echoes(noisy, tmp_path):
    """Taken for white, its noise would make an echo a pulse."""
    ended = fwclass("decompose", noisy, tmp_path / "o.laz")
    assert ended.returncode == 0 and "implausible" not in ended.stderr
    las = laspy.read(tmp_path / "o.laz")
    assert 900 <= len(las) <= 903 and (np.asarray(las.z) < 264.0).sum() <= 1


def implausible(path):
    las = laspy.read(path)
    return las, (np.asarray(las["fit flags"]) & 128) > 0


def test_decompose_tells_and_ends_with_4(haunted, tmp_path):
    ended = fwclass("decompose", haunted, tmp_path / "o.laz")
    assert ended.returncode == 4 and "more waveforms have an echo that no scene makes" in ended.stderr
    assert "are implausible, and neither" in ended.stderr and "have no return within 5 ns" in ended.stderr
    las, bad = implausible(tmp_path / "o.laz")
    assert bad.mean() > 0.05 and (las.z[~bad] > 262.0).all(), "what is far below the ground is flagged"
    assert (las.withheld == bad).all() and (las.classification[bad] == 7).all()
    last = ~bad & (np.asarray(las.return_number) >= np.asarray(las.number_of_returns))
    assert len(np.unique(las.gps_time[last])) == last.sum() == len(np.unique(las.gps_time)), "one last echo a pulse"
    assert fwclass("decompose", haunted, tmp_path / "o.laz", "--overwrite", "--accept-implausible").returncode == 0
    settings = ("--set", "plausibility.accept=true")
    assert fwclass("decompose", haunted, tmp_path / "o.laz", "--overwrite", *settings).returncode == 0


def test_a_packet_file_that_is_cut_off_is_told(noisy, tmp_path):
    """Half of the waveforms are gone: one line says so, not only a count of faults."""
    (tmp_path / "a.las").write_bytes(noisy.read_bytes())
    packets = noisy.with_suffix(".wdp").read_bytes()
    (tmp_path / "a.wdp").write_bytes(packets[: len(packets) // 2])
    ended = fwclass("decompose", tmp_path / "a.las", tmp_path / "o.laz")
    assert "451 of 900 returns (50.1 %) have a waveform that cannot be read" in ended.stderr
    assert "is the packet file whole? (a)" in ended.stderr and len(laspy.read(tmp_path / "o.laz")) >= 900


def with_hole(source: Path, target: Path, first: float, last: float) -> None:
    """A copy in which the bytes between two shares of the file are zeros, as a copy that broke off leaves them."""
    whole = bytearray(source.read_bytes())
    begin, end = int(len(whole) * first), int(len(whole) * last)
    whole[begin:end] = bytes(end - begin)
    target.write_bytes(whole)


@pytest.mark.parametrize(("last", "code"), [(0.7, 4), (0.42, 0)])
def test_a_hole_of_zeros_in_a_packet_file_is_told(noisy, tmp_path, last, code):
    """Its waveforms are as long as the others and hold nothing; a few are told, many end with 4."""
    (tmp_path / "a.las").write_bytes(noisy.read_bytes())
    with_hole(noisy.with_suffix(".wdp"), tmp_path / "a.wdp", 0.4, last)
    ended = fwclass("decompose", tmp_path / "a.las", tmp_path / "o.laz")
    assert ended.returncode == code, ended.stderr
    count = int(900 * (last - 0.4))
    assert any(f"{n} of 900 pulses" in ended.stderr for n in range(count - 2, count + 1)), ended.stderr
    assert "have nothing but zeros, or the digitiser's limit, for a waveform" in ended.stderr
    assert ("waveforms are nothing but zeros or the limit than a sound survey has" in ended.stderr) == (code == 4)


def test_waveforms_at_the_limit_are_told(noisy, tmp_path):
    """Nothing was found in them, and nothing said."""
    (tmp_path / "a.las").write_bytes(noisy.read_bytes())
    whole = noisy.with_suffix(".wdp").read_bytes()
    (tmp_path / "a.wdp").write_bytes(whole[:60] + b"\xff" * (len(whole) - 60))
    ended = fwclass("decompose", tmp_path / "a.las", tmp_path / "o.laz")
    assert ended.returncode == 4 and "900 of 900 pulses (100.0 %) have nothing but zeros, or" in ended.stderr
    assert len(laspy.read(tmp_path / "o.laz")) >= 900, "the vendor's returns are kept"


@pytest.mark.parametrize("harm", ["hole", "cut"])
def test_a_pulsewaves_file_whose_waves_are_lost_ends_with_4(tmp_path, harm):
    """Zeros in a `.wvs` read as pulses without samples, like those of which nothing came back."""
    source = tmp_path / "a.pls"
    pulsewaves(source, pulses=300)
    waves = source.with_suffix(".wvs")
    if harm == "hole":
        with_hole(waves, waves, 0.4, 0.7)
    else:
        waves.write_bytes(waves.read_bytes()[: int(0.7 * waves.stat().st_size)])
    ended = fwclass("decompose", source, tmp_path / "o.laz")
    assert ended.returncode == 4 and "have a waveform that cannot be read" in ended.stderr, ended.stderr


def test_ground_of_a_decomposed_file_does_not_see_them(haunted, tmp_path):
    fwclass("decompose", haunted, tmp_path / "o.laz")
    assert (
        fwclass(
            "ground", tmp_path / "o.laz", tmp_path / "g.laz", "--accept-implausible", "--dtm", tmp_path / "dtm.tif"
        ).returncode
        == 0
    )
    with rasterio.open(tmp_path / "dtm.tif") as raster:
        assert raster.read(1, masked=True).min() > 264.0


@pytest.mark.slow
def test_a_run_tells_keeps_its_terrain_and_ends_with_4(haunted, tmp_path):
    (tmp_path / "strip_01.las").write_bytes(haunted.read_bytes())
    (tmp_path / "strip_01.wdp").write_bytes(haunted.with_suffix(".wdp").read_bytes())
    (tmp_path / "c.yaml").write_text(CONFIG)
    ended = fwclass("run", tmp_path / "c.yaml", "--out", tmp_path / "r", "--workers", 0)
    assert ended.returncode == 4, ended.stderr
    assert "implausible" in ended.stderr and "where: strip_01" in ended.stderr
    made = json.loads((tmp_path / "r" / "report.json").read_text())["plausibility"]
    strip = made["strips"][0]
    assert strip["implausible"] > 45 and strip["lag1"] > 0.4 and strip["inflation"] < 1.1 and made["remarks"]
    assert strip["implausible"] <= strip["below"] + strip["weak"]
    page = (tmp_path / "r" / "report.html").read_text()
    assert "neither ground filter nor terrain sees them" in page and 'id="plausibility"' in page
    with rasterio.open(tmp_path / "r" / "rasters" / "dtm.tif") as raster:
        assert raster.read(1, masked=True).min() > 264.0, "the ground is at 265 m"
    tiles = [implausible(path) for path in (tmp_path / "r" / "laz" / "tiles").glob("*.laz")]
    assert sum(bad.sum() for _, bad in tiles) == strip["implausible"]
    words = ("run", tmp_path / "c.yaml", "--out", tmp_path / "r", "--workers", 0)
    accepted = fwclass(*words, "--accept-implausible")
    assert accepted.returncode == 0 and "implausible" in accepted.stderr
    other = fwclass(*words, "--accept-implausible", "--set", "tile.size=9", "--set", "read.chunk_pulses=200")
    again = json.loads((tmp_path / "r" / "report.json").read_text())["plausibility"]
    assert other.returncode == 0 and again["strips"] == made["strips"], "whatever the tiles and chunks"


def test_leaves_that_the_vendor_has_not_are_no_fault(tmp_path):
    """Three of four echoes have no return, all of them above the ground."""
    path = flat_survey(tmp_path / "a.las", 300, 0.0, extra=3)
    assert fwclass("decompose", path, tmp_path / "o.laz").returncode == 0
    las, bad = implausible(tmp_path / "o.laz")
    assert len(las) > 3.5 * 300 and bad.mean() < 0.01


@pytest.mark.parametrize("seed", [0, 1])
def test_white_noise_is_found_white(tmp_path, seed):
    survey(tmp_path / "a.las", 300, seed=seed)
    ended = fwclass("decompose", tmp_path / "a.las", tmp_path / "o.laz")
    assert ended.returncode == 0 and "plausibility" not in ended.stderr
    assert not implausible(tmp_path / "o.laz")[1].any()


@pytest.mark.skipif(not REAL.is_dir(), reason="needs ../shared/data")
@pytest.mark.parametrize("name", ["riegl_q680i.las"])
def test_sound_files_are_not_refused(tmp_path, name):
    assert fwclass("decompose", REAL / name, tmp_path / "o.laz").returncode == 0
    assert implausible(tmp_path / "o.laz")[1].sum() <= 3


@pytest.mark.slow
@pytest.mark.skipif(not (REAL / "geolas_example2.pls").is_file(), reason="needs ../shared/data")
def test_a_file_whose_samples_are_stored_wrongly_is_taken_apart_and_poor_fits_end_with_4(tmp_path):
    """Its 16 bit records hold 8 bit ones, read as they were recorded; few fit poorly."""
    ended = fwclass("decompose", REAL / "geolas_example2.pls", tmp_path / "o.laz")
    assert ended.returncode == 0 and "taken apart: 1,640" in ended.stderr
    assert "4.11 ns wide at 162 DN and 2.97 ns at 420 DN" in ended.stderr
    assert "by the recorded outgoing pulses" not in ended.stderr, "as wide as echoes of their height"
    assert "3.74 ns of samples up to 255 DN" in ended.stderr
    strict = ("--set", "plausibility.max_poor=0.0001", "--set", "decompose.poor_misfit=1.5")
    refused = fwclass("decompose", REAL / "geolas_example2.pls", tmp_path / "s.laz", *strict)
    assert refused.returncode == 4 and "more fitted echoes fit poorly than a sound survey has" in refused.stderr
    accepted = fwclass("decompose", REAL / "geolas_example2.pls", tmp_path / "a.laz", *strict, "--accept-implausible")
    assert accepted.returncode == 0 and (tmp_path / "a.laz").read_bytes() == (tmp_path / "s.laz").read_bytes()
    looked = fwclass("info", "--waveforms", REAL / "geolas_example2.pls", "--out", tmp_path / "a.png")
    assert "neighbouring samples correlate by 0.7" in looked.stdout
    assert implausible(tmp_path / "o.laz")[1].mean() < 0.1
