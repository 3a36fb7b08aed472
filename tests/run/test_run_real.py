"""The surveys of real data that come with fwclass, by the command line; skipped where the data is absent."""

import json

import laspy
import numpy as np
import pytest
from commandline import fwclass


def run(name, directory, out, *settings):
    words = ["run", name, "--out", out, "--workers", "0", "--set", f"survey.directory={directory}", *settings]
    result = fwclass(*words)
    assert result.returncode == 0, result.stderr
    return json.loads((out / "report.json").read_text())


def test_the_riegl_sample_goes_from_packets_to_classes(shared_data, tmp_path):
    source = shared_data / "waveform" / "riegl_q680i.las"
    report = run("riegl-sample", source.parent, tmp_path / "r", "--set", "train.trees=100")
    counts = report["counts"]
    assert counts["pulses"] == 2370 and counts["returns"] == 2535 and counts["returns_without_packet"] == 0
    assert counts["echoes_in_tiles"] == counts["echoes_decomposed"] >= 2535
    assert report["accuracy"]["kappa"] > 0.3  # 0.37 to 0.47 over six draws of the forest
    before, after = laspy.read(source), laspy.read(tmp_path / "r" / "laz" / "strips" / "riegl_q680i.laz")
    for name in before.point_format.dimension_names:
        if name != "classification":
            np.testing.assert_array_equal(before[name], after[name], err_msg=name)
    assert (tmp_path / "r/laz/strips/riegl_q680i.wdp").read_bytes() == source.with_suffix(".wdp").read_bytes()


@pytest.mark.slow
def test_tiles_without_waveforms_are_classified_in_four_classes(shared_data, tmp_path):
    report = run("p1", shared_data / "ign_hd", tmp_path / "r", "--set", "train.trees=30")
    assert report["counts"]["echoes_in_tiles"] == 417_106 and report["counts"]["pulses"] == 0
    assert report["accuracy"]["overall_accuracy"] > 0.8 and report["accuracy"]["kappa"] > 0.7
