"""`fwclass clean`: what was delivered stays, what is left runs again to the same bytes."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil

import pytest
from commandline import fwclass
from shapely import box
from shapely.geometry import mapping
from smallsurvey import small_survey

from fwclass.errors import LockedError
from fwclass.operate.clean import clean
from fwclass.operate.sizes import sizes_of
from fwclass.store.lock import writer
from fwclass.store.seal import seal, unseal


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A run ``r`` with two generations."""
    place = tmp_path_factory.mktemp("clean")
    small_survey(place)
    for more in (("--set", "train.trees=3"), ()):
        ended = fwclass("run", "s.yaml", "--out", "r", "--workers", 0, *more, cwd=place)
        assert ended.returncode == 0, ended.stderr
    return place


@pytest.fixture(scope="module")
def labelled(tmp_path_factory):
    """A run ``r`` with check points that polygons label, of which the delivery alone is left."""
    place = tmp_path_factory.mktemp("labelled")
    small_survey(place)
    boxes = [(500_000 + 5 * i, 5_400_000, 500_005 + 5 * i, 5_400_040) for i in range(16)]
    features = [
        {"type": "Feature", "properties": {"k": 2 + 3 * (i % 2)}, "geometry": mapping(box(*b))}
        for i, b in enumerate(boxes)
    ]
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
    collection = {"type": "FeatureCollection", "crs": crs, "features": features}
    (place / "p.geojson").write_text(json.dumps(collection))
    points = "".join(f"{500_010 + i},5400020,{200.5 + i / 20}\n" for i in range(9))
    (place / "checks.csv").write_text(f"x,y,z\n{points}")
    text = (place / "s.yaml").read_text().replace("[a.las]", "['[ab].las']\n  crs: EPSG:25832")
    polygons = "{kind: polygons, files: [p.geojson], field: k}"
    checks = "quality: {check_points: {file: checks.csv}}\n"
    (place / "s.yaml").write_text(text.replace("{kind: source}", polygons) + checks)
    made = fwclass("run", "s.yaml", "--out", "r", "--workers", 0, "--accept-implausible", cwd=place)
    assert made.returncode == 0, made.stderr
    assert fwclass("clean", "r", "--keep", "delivery", cwd=place).returncode == 0
    return place


def delivered(root):
    """Digests of all that readers see, links followed; the reports tell times."""
    files = sorted(p for p in (root / "current").resolve().rglob("*") if p.is_file())
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_earlier_deliveries_go_then_the_store_and_a_run_makes_the_same(place):
    root = place / "r"
    before, size = delivered(root), sizes_of(root, None).total
    told = fwclass("status", "r", "--json", cwd=place)
    disk = json.loads(told.stdout)["disk"]
    told = disk["delivery"] + disk["earlier"] + sum(disk["parts"].values())
    assert disk["total"] == size and 0.95 * size < told < size  # the rest are logs, links and the words of runs
    assert disk["delivery"] > disk["earlier"] > 0 and disk["parts"]["features"] > 0
    assert (
        f"disk: {size / 1e6:,.1f} MB in {disk['files']:,} files: the delivery"
        in fwclass("status", "r", cwd=place).stdout
    )
    ended = fwclass("clean", "r", "--keep", "latest", cwd=place)
    assert ended.returncode == 0 and "0001 removed" in ended.stdout, ended.stderr
    again = fwclass("run", "s.yaml", "--out", "r", "--workers", 0, cwd=place)
    assert again.returncode == 0 and " computed" not in again.stderr and delivered(root) == before
    ended = fwclass("clean", "r", "--keep", "delivery", cwd=place)
    assert ended.returncode == 0 and delivered(root) == before and sizes_of(root, None).total < 0.6 * size
    assert not list((root / "logs").rglob("*.log"))  # of parts that are not there any more
    told = fwclass("status", "r", cwd=place)
    assert told.returncode == 0 and " stands; nothing is left of what it was made of" in told.stdout, told.stdout
    assert fwclass("status", "s.yaml", "--out", "r", "--set", "run.workers=0", cwd=place).returncode == 3
    assert "missing" not in told.stdout and "not done" not in told.stdout
    assert fwclass("history", "r", cwd=place).stdout.count("done (0)") == 3
    again = fwclass("run", "s.yaml", "--out", "r", "--workers", 0, cwd=place)
    assert again.returncode == 0, again.stderr
    files = delivered(root)
    told = {"report.html", "report.json", "generation.json", "manifest.json"}
    assert {n: d for n, d in files.items() if n not in told} == {n: d for n, d in before.items() if n not in told}


def test_a_classification_stays_behind_deliveries_of_another_workflow(place):
    quality = ("run", "s.yaml", "--out", "q", "--workers", 0, "--workflow", "quality")
    assert fwclass("run", "s.yaml", "--out", "q", "--workers", 0, cwd=place).returncode == 0
    ended = fwclass(*quality, "--set", "run.keep_generations=1", cwd=place)
    assert ended.returncode == 0 and "has no laz, model" in ended.stderr, ended.stderr
    ended = fwclass(*quality, "--set", "quality.cell=4", "--set", "run.keep_generations=1", cwd=place)
    assert ended.returncode == 0, ended.stderr
    for keep in ("latest", "delivery"):
        ended = fwclass("clean", "q", "--keep", keep, cwd=place)
        assert ended.returncode == 0 and "0001 stays: it alone has laz, model" in ended.stdout, ended.stdout
        assert sorted(p.name for p in (place / "q/generations").iterdir()) == ["0001", "0003"]
    assert list((place / "q/generations/0001/laz/tiles").glob("*.laz"))


@pytest.mark.slow
def test_a_run_that_keeps_no_parts_keeps_its_deliveries(place):
    words = ("run", "s.yaml", "--out", "bare", "--workers", 0)
    assert fwclass(*words, "--set", "train.trees=3", cwd=place).returncode == 0
    missed = fwclass(*words, "--set", "run.keep_intermediate=false", "--set", "assess.min_kappa=1.0", cwd=place)
    assert missed.returncode == 4 and "parts removed" not in missed.stderr
    held = sizes_of(place / "bare", None).total
    ended = fwclass(*words, "--set", "run.keep_intermediate=false", cwd=place)
    assert ended.returncode == 0 and "parts removed (run.keep_intermediate)" in ended.stderr
    assert sizes_of(place / "bare", None).total < held and not any((place / "bare" / "store").rglob("table.parquet"))
    assert len([p for p in (place / "bare" / "generations").iterdir() if p.is_dir()]) >= 2
    assert "have the bytes that were written" in fwclass("status", "bare", "--verify", cwd=place).stdout
    again = fwclass(*words, cwd=place)
    assert again.returncode == 0, again.stderr
    told = {"report.html", "report.json", "generation.json", "manifest.json"}
    bare, whole = (delivered(place / name) for name in ("bare", "r"))
    assert {n: d for n, d in bare.items() if n not in told} == {n: d for n, d in whole.items() if n not in told}


def test_sources_that_changed_after_it_was_cleaned_are_told(tmp_path):
    """`status` said that all was done."""
    place = small_survey(tmp_path)
    place.write_text(place.read_text().replace("[a.las]", "['*.las']"))
    assert fwclass("run", "s.yaml", "--out", "r", "--workers", 0, cwd=tmp_path).returncode == 0
    assert fwclass("clean", "r", "--keep", "delivery", cwd=tmp_path).returncode == 0
    os.utime(tmp_path / "a.las", (1, 1))
    shutil.copy(tmp_path / "a.las", tmp_path / "copy")
    assert fwclass("status", "r", cwd=tmp_path).returncode == 0
    (tmp_path / "b.las").write_bytes((tmp_path / "a.las").read_bytes()[:-1] + b"\x01")
    told = fwclass("status", "r", cwd=tmp_path)
    assert told.returncode == 3 and "sources changed or came since then: b.las" in told.stdout, told.stdout
    (tmp_path / "b.las").rename(tmp_path / "a.las")
    told = fwclass("status", "r", cwd=tmp_path)
    assert told.returncode == 3 and "sources changed or came since then: a.las" in told.stdout, told.stdout
    (tmp_path / "copy").rename(tmp_path / "a.las")
    assert fwclass("status", "r", cwd=tmp_path).returncode == 0


def test_all_files_that_changed_after_it_was_cleaned_are_told(labelled):
    """Where polygons label the survey they alone were looked at, and check points nowhere."""
    assert fwclass("status", "r", cwd=labelled).returncode == 0
    (labelled / "other.csv").write_text((labelled / "checks.csv").read_text() + "500030,5400020,201.5\n")
    (labelled / "other.las").write_bytes((labelled / "a.las").read_bytes()[:-1] + b"\x01")
    (labelled / "other.geojson").write_text((labelled / "p.geojson").read_text() + "\n")
    for name, other in (("a.las", "las"), ("b.las", "las"), ("p.geojson", "geojson"), ("checks.csv", "csv")):
        file = labelled / name
        before = file.read_bytes() if file.exists() else None
        shutil.copy(labelled / f"other.{other}", file)
        told = fwclass("status", "r", cwd=labelled)
        assert told.returncode == 3 and f"sources changed or came since then: {name}\n" in told.stdout, told.stdout
        file.unlink() if before is None else file.write_bytes(before)
    assert fwclass("status", "r", cwd=labelled).returncode == 0


def test_a_delivery_that_lacks_a_file_is_told_by_status(place, tmp_path):
    """It said that all was done, also of one that stands alone; --verify alone saw it."""
    root = shutil.copytree(place / "r", tmp_path / "r", symlinks=True)
    for file, name in (
        (root / "current" / "laz" / "survey.vpc", "survey.vpc"),
        (root / "current" / "report.html", "report.html"),
    ):
        before = file.read_bytes()
        file.unlink()
        told = fwclass("status", place / "s.yaml", "--out", root)
        assert told.returncode == 3 and "is not what was delivered" in told.stdout and name in told.stdout, told.stdout
        told = json.loads(fwclass("status", place / "s.yaml", "--out", root, "--json").stdout)
        assert not told["done"] and [n.rpartition("/")[2] for n in told["delivery_lacks"]] == [name]
        file.write_bytes(before)
    assert fwclass("status", place / "s.yaml", "--out", root).returncode == 0
    assert fwclass("clean", root, "--keep", "delivery").returncode == 0
    assert fwclass("status", root).returncode == 0
    (root / "current" / "laz" / "survey.vpc").write_bytes(b"")
    told = fwclass("status", root)
    assert told.returncode == 3 and "is not what was delivered" in told.stdout and "survey.vpc" in told.stdout
    assert fwclass("run", "s.yaml", "--out", root, "--workers", 0, cwd=place).returncode == 0
    assert fwclass("status", root).returncode == 0


def test_what_a_later_run_read_is_not_what_the_delivery_was_made_of(place, tmp_path):
    """A run of chosen tiles, or one that failed, read other sources: `status` took them for those of the delivery."""
    path = small_survey(tmp_path)
    words, before = ("run", "s.yaml", "--out", "r", "--workers", 0), path.read_text()
    assert fwclass(*words, cwd=tmp_path).returncode == 0
    assert fwclass("clean", "r", "--keep", "delivery", cwd=tmp_path).returncode == 0
    (tile,) = (p.name.split(".")[0] for p in sorted((tmp_path / "r" / "laz" / "tiles").iterdir())[:1])
    source = (tmp_path / "a.las").read_bytes()
    (tmp_path / "a.las").write_bytes(source[:-1] + b"\x01")
    path.write_text(before.replace("trees: 5", "trees: 4"))
    assert fwclass(*words, "--tiles", tile, cwd=tmp_path).returncode == 0
    assert fwclass("clean", "r", "--keep", "delivery", cwd=tmp_path).returncode == 0
    told = fwclass("status", "r", cwd=tmp_path)
    assert told.returncode == 3 and "came since then: a.las, the settings\n" in told.stdout, told.stdout
    (tmp_path / "a.las").write_bytes(source)
    path.write_text(before)
    assert fwclass("status", "r", cwd=tmp_path).returncode == 0


def test_settings_that_changed_after_it_was_cleaned_are_told(tmp_path):
    """`status` said that all was done, whatever the survey's file had become."""
    path = small_survey(tmp_path)
    before = path.read_text()
    assert fwclass("run", "s.yaml", "--out", "r", "--workers", 0, cwd=tmp_path).returncode == 0
    assert fwclass("clean", "r", "--keep", "delivery", cwd=tmp_path).returncode == 0
    for text, code in ((before + "# a remark\nview: {cache: 400}\n", 0), (before.replace("trees: 5", "trees: 9"), 3)):
        path.write_text(text)
        told = fwclass("status", "r", cwd=tmp_path)
        assert told.returncode == code and ("the settings train.trees" in told.stdout) == (code == 3), told.stdout
    path.write_text(before)
    assert fwclass("status", "r", cwd=tmp_path).returncode == 0


def test_a_model_that_was_exchanged_after_it_was_cleaned_is_told(place, tmp_path):
    """`status` said that all was done: of what a run reads, the model alone was not looked at."""
    shutil.copytree(place / "r" / "model", tmp_path / "m")
    small_survey(tmp_path)
    words = ("--set", "survey.model=m", "--accept-implausible")
    assert fwclass("run", "s.yaml", "--out", "r", "--workers", 0, *words, cwd=tmp_path).returncode == 0
    assert fwclass("clean", "r", "--keep", "delivery", cwd=tmp_path).returncode == 0
    (tmp_path / "m" / "card.json").touch()
    assert fwclass("status", "r", cwd=tmp_path).returncode == 0
    before = (tmp_path / "m" / "card.json").read_text()
    (tmp_path / "m" / "card.json").write_text(before.replace("}", "} ", 1))
    for more in ((), ("--verify",)):
        told = fwclass("status", "r", *more, cwd=tmp_path)
        assert told.returncode == 3 and f"came since then: {tmp_path / 'm'}\n" in told.stdout, told.stdout
    (tmp_path / "m" / "card.json").write_text(before)
    assert fwclass("status", "r", cwd=tmp_path).returncode == 0
    (tmp_path / "r" / "store" / "delivered.json").unlink()
    kept = tmp_path / "r" / "store" / "inputs.json"
    digests = {
        name: facts for name, facts in unseal(json.loads(kept.read_text())).items() if not name.startswith("model ")
    }
    kept.write_text(json.dumps(seal(digests)))  # as earlier versions kept them
    assert fwclass("status", "r", cwd=tmp_path).returncode == 0


def test_the_files_of_a_simulated_survey_stay(tmp_path):
    """`status` called the rest missing, and ended with 3."""
    small = (f"simulate.{words}" for words in ("size=60", "strips=1", "pulse_density=1"))
    more = [word for setting in small for word in ("--set", setting)]
    ended = fwclass("run", "demo", "--workflow", "ground", "--out", "r", "--workers", 0, *more, cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert fwclass("clean", "r", "--keep", "delivery", cwd=tmp_path).returncode == 0
    told = fwclass("status", "r", cwd=tmp_path)
    assert told.returncode == 0 and " stands; nothing is left" in told.stdout and "sources" not in told.stdout


def test_a_full_disk_is_cleaned(place, tmp_path, monkeypatch):
    """It could not be: the name of who holds the run could not be written."""
    shutil.copytree(place / "r", tmp_path / "r", symlinks=True)

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("fwclass.store.lock.os.write", full)
    with writer(tmp_path / "r"), pytest.raises(LockedError, match="one that did not leave its name"):
        clean(tmp_path / "r", "delivery", print)
    assert clean(tmp_path / "r", "delivery", print).parts > 0


@pytest.mark.parametrize(
    ("words", "says"),
    [(("nothing", "--keep", "delivery"), "no such run"), (("r",), "--keep"), (("r", "--keep", "all"), "--keep")],
)
def test_what_cannot_be_cleaned(place, words, says):
    ended = fwclass("clean", *words, cwd=place)
    assert ended.returncode == 2 and says in ended.stderr


def test_a_run_without_a_delivery_is_left_alone(place):
    ended = fwclass("run", "s.yaml", "--out", "half", "--workers", 0, "--set", "train.trees=0", cwd=place)
    assert ended.returncode == 2
    (place / "half" / "store" / "tile" / "0_0").mkdir(parents=True)
    ended = fwclass("clean", "half", "--keep", "delivery", cwd=place)
    assert ended.returncode == 2 and (place / "half" / "store" / "tile" / "0_0").exists()


def test_a_run_whose_links_lead_elsewhere_is_left_alone(tmp_path):
    small_survey(tmp_path)
    assert fwclass("run", "s.yaml", "--out", "r", "--workers", 0, cwd=tmp_path).returncode == 0
    (tmp_path / "r" / "generations").rename(tmp_path / "elsewhere")
    (tmp_path / "r" / "generations").symlink_to(tmp_path / "elsewhere")
    parts = sorted((tmp_path / "r" / "store").rglob("*"))
    ended = fwclass("clean", "r", "--keep", "delivery", cwd=tmp_path)
    assert ended.returncode == 1 and "belong into the run directory itself" in ended.stderr, ended.stderr
    assert sorted((tmp_path / "r" / "store").rglob("*")) == parts
