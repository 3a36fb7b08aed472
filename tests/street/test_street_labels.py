"""Labels of a recording that no class counts."""

from dataclasses import replace

import numpy as np
import pytest
from streetmaker import config, drive

from fwclass.single_file.street.train import crown_lines, train
from fwclass.street.recording_parquet import write_recording


@pytest.mark.parametrize("share, place", [(0.05, "remarks"), (0.6, "implausible")])
def test_labels_that_no_class_counts_are_counted_and_told(tmp_path, share, place):
    """They were left out in silence: half a street could train and test nothing."""
    draw = np.random.default_rng(7)
    strange = [
        replace(
            f, labels=np.where((f.labels > 0) & (draw.random(len(f.labels)) < share), 77, f.labels).astype(np.uint8)
        )
        for f in drive()
    ]
    write_recording(tmp_path / "drive.parquet", strange)
    summary = train(config("street.split=random"), tmp_path / "model", False, False, [].append, tmp_path)
    (text,) = [t for t in summary[place] if "no class counts" in t]
    other = "implausible" if place == "remarks" else "remarks"
    assert "77 (" in text and not any("no class counts" in t for t in summary[other])


@pytest.mark.parametrize("blocks, said", [(4, True), (5, False)])
def test_figures_without_intervals_say_why(blocks, said):
    figures = dict.fromkeys(("error", "detection", "false_alarm", "error_interval"), None)
    figures |= {"detection_interval": None, "false_alarm_interval": None, "kappa": None, "confusion": [[9]]}
    lines = crown_lines({**figures, "rows": 9, "blocks": blocks})
    assert ("too few for intervals" in lines[0]) is said
