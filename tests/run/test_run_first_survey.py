"""docs/first-survey.md, walked from its first line to its last on public files."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "first-survey.md"
CLASSES = {2: 2, 3: 5, 4: 5, 5: 5, 6: 6}
"""What the files' codes are delivered as."""


def cells(las: laspy.LasData) -> list[tuple[int, int, int]]:
    """Places of all points [mm]."""
    return list(zip(*(np.rint(1000 * np.asarray(las[c])).astype(int).tolist() for c in "xyz"), strict=True))


def corrected(directory: Path, sources: Path) -> int:
    """What a user does in QGIS, done by another writer: the files' own classes in one corner of a tile."""
    own: dict[tuple[int, int, int], int] = {}
    for source in sources.glob("*.laz"):
        las = laspy.read(source)
        own |= dict(zip(cells(las), np.asarray(las.classification).tolist(), strict=True))
    (path,) = directory.glob("*.copc.laz")
    las = laspy.read(path)
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = las.header.scales, las.header.offsets
    header.add_extra_dims([laspy.ExtraBytesParams("pulse", "u4")])
    plain = laspy.LasData(header)
    for name in ("X", "Y", "Z", "point_source_id", "return_number", "classification", "pulse"):
        plain[name] = np.asarray(las[name])
    classes = np.asarray(plain.classification).copy()
    right = np.array([CLASSES.get(own[c], k) for c, k in zip(cells(las), classes.tolist(), strict=True)])
    near = (plain.x < plain.x.min() + 25) & (plain.y < plain.y.min() + 25)
    changed = np.flatnonzero(near & (right != classes))
    classes[changed] = right[changed]
    plain.classification = classes
    path.unlink()
    plain.write(path)
    return len(changed)


@pytest.mark.slow
def test_the_page_is_walked(shared_data: Path, tmp_path: Path) -> None:
    strips = tmp_path / "strips"
    strips.mkdir()
    for file in sorted((shared_data / "ign_hd").glob("urban_*.laz")):
        shutil.copy(file, strips)
    program = f'fwclass() {{ "{sys.executable}" -P -m fwclass "$@"; }}\n'
    said = []
    for block in re.findall(r"^```sh\n(.*?)^```", PAGE.read_text(), re.M | re.S):
        done = subprocess.run(
            ["bash", "-ec", program + block], cwd=tmp_path, capture_output=True, text=True, timeout=900
        )
        assert done.returncode == 0, (block, done.stdout[-2000:], done.stderr[-2000:])
        said.append(done.stdout + done.stderr)
        if "label checkout" in block:
            count = corrected(tmp_path / "mend", strips)
            assert count > 10
        if "--workflow ground" in block:
            assert (tmp_path / "runs/strips/rasters/dtm.tif").is_file()
            assert not (tmp_path / "runs/strips/model").exists()
        if "collect" in block:
            assert f"{count:,} echoes" in said[-1]
            report = json.loads((tmp_path / "runs/strips/report.json").read_text())
            assert report["accuracy"]["overall_accuracy"] > 0.9
    assert len(said) == 8
    run = tmp_path / "runs" / "strips"
    assert all((run / name).exists() for name in ("report.html", "survey.qgz", "laz/tiles", "rasters/classes.tif"))
    assert (tmp_path / "page" / "index.html").is_file() and not any((run / "store").rglob("table.parquet"))
