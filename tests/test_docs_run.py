"""Every command on every page is run: in a directory that has what the page speaks of, small."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import lasmaker
import laspy
import numpy as np
import pyproj
import pytest
import streetmaker
from commandline import fwclass
from smallsurvey import small_survey
from test_docs_commands import PAGES, ROOT, command_of, lines

from fwclass.formats.wkb import box_wkb
from fwclass.grid import Box
from fwclass.publish.gpkg import Layer, write_gpkg

QUICK = ("train.trees=3", "train.samples_per_class=300", "publish.figure_pixels=200")
TOWN = ("simulate.size=60", "simulate.strips=2", *QUICK, "areas.train=[[512000,5403000,512030,5403060]]", "areas.gap=2")

ELSEWHERE = {
    # They end with Ctrl-C, need another machine, or a city: what runs them, and a word of it that stands there.
    r"--scheduler (tcp|tls)://": ("tests/run/test_run_many_hosts.py", "scheduler"),
    r"s3://": ("tests/run/test_run_many_machines.py", "s3://"),
    r"^schedule ": ("tests/test_cli_schedule.py", "--every"),
    r"^history s3": ("tests/test_cli_schedule_remote.py", "history"),
    r"^street run": ("tests/street/test_street_online.py", "tcp://"),
    r"^view (?!.*--(export|worklist))": ("tests/view/test_view_page.py", "Server("),
    r"--workflow (fan2013|xiong2018|shi2019)": ("tests/run/test_run_papers.py", "workflow"),
    r"--workflow li2018": ("tests/street/test_li_workflow.py", "li2018"),
    r"--workflow he2023": ("tests/run/test_run_he.py", "he2023"),
    r"^select .* --method thinning": ("tests/run/test_run_select.py", "thinning"),
    r"^compile$": ("tests/test_compiling.py", "ahead"),
}
"""Lines by pattern, without the word fwclass."""

WALKED = {"first-survey.md": "tests/run/test_run_first_survey.py"}
"""Pages whose blocks a test of their own runs in order."""

NAMES = (
    (r"\s+\[--.*", ""),
    (r"\s>.*", ""),
    (r"^(voxels|profile) (CONF\|FILE|my-survey\.yaml)", r"\1 strip.las"),  # which has waveforms
    (r"\bRUN\b", "runs/my-survey"),
    (r"\bOTHER\b", "runs/other"),
    (r"\bFILE\b", "worklist.gpkg"),
    (r"(?<=--export )DIR", "page"),
    (r"^adapt (\S+) MODEL OUT", r"adapt \1 rows-dir adapted --set adapt.most_unsure=1"),
    (r"(?<=--model )DIR|(?<=survey.model=)DIR|\bMODEL\b", "forest-dir"),
    (r"\bDIR\b", "mend"),
    (r"\bOUT\b", "forest"),
    (r"ground=2;vegetation=3,4,5;building=6", "ground=2;bush=5"),
    (r"/data/", "data/"),
    (r"64=20", "5=20"),
    (r"tile\.size=200", "tile.size=200 --out runs/larger"),
    (r"(drive|other)\.bag", "drive.parquet"),
    (r"--out drive\.parquet", "--out annotated.parquet"),
    (
        r"^select my-survey\.yaml|^run my-survey\.yaml (?=.*(select/|thin))",
        lambda m: f"{m[0].split()[0]} demo --out runs/my-survey ",
    ),
    (r"^(?!select demo)(.*)building, vegetation", r"\1ground, bush"),
    (r"--order zc,echo_number,width", "--order zc,height_range_c100 --candidates zc,height_range_c100"),
    (r"--workflow (quality|ground)$", r"--workflow \1 --out runs/\1"),
    (r"(--method forward) (?=--to )", r"\1 --candidates fan2013 "),
    (r"^suggest .*", r"\g<0> --size 5 --overwrite"),
    (r"^label confirm \S+ places", "label confirm runs/other looked-at"),
    (r"^(label .*)places\.gpkg", r"\1looked-at.gpkg"),
    (r"--method scales", "--method scales --set classify.refine.scales=[2.1,4.5]"),
    (r"^run my-survey\.yaml --workflow mine\.py$", "run my-survey.yaml --workflow mine.py --out runs/mine"),
    (r"^seams runs/my-survey --workflow mine\.py", "seams runs/mine --workflow mine.py"),
)
"""What stands on a page for something of the reader's, and what it is here."""


def test_what_is_run_elsewhere_is_there() -> None:
    for path, word in ELSEWHERE.values():
        assert word in (ROOT / path).read_text(encoding="utf-8"), path
    for page, path in WALKED.items():
        assert page in (ROOT / path).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A directory with everything that a page names."""
    root = tmp_path_factory.mktemp("docs")
    town = [w for s in TOWN for w in ("--set", s)]
    assert fwclass("simulate", "demo", "--out", "town", *town, cwd=root).returncode == 0
    strip = root / "town" / "strips" / "strip_01.las"
    shutil.copy(strip, root / "strip.las")
    shutil.copy(strip.with_suffix(".wdp"), root / "strip.wdp")
    shutil.copy(root / "town" / "trajectory.csv", root / "flight.csv")
    survey = small_survey(root)
    (root / "strips").mkdir()
    (root / "a.las").rename(root / "strips" / "a.las")
    text = (
        survey.read_text()
        .replace("sources: [a.las]", 'sources: ["strips/*.las"]')
        .replace("name: small", "name: my-survey\n  crs: EPSG:25832")
    )
    for name in ("my-survey.yaml", "survey.yaml"):
        (root / name).write_text(text)
    las = laspy.read(root / "strips" / "a.las")
    for name in ("in.laz", "labelled.laz", "out.laz", "reference.las", "reference.laz", "classified.laz"):
        las.write(root / name)
    for name in ("reference", "classified"):
        (root / name).mkdir()
        las.write(root / name / "a.laz")
    lasmaker.write_las(
        root / "old.las", np.c_[las.x, las.y, las.z], point_format=1, classification=np.asarray(las.classification)
    )
    python = (ROOT / "docs" / "extending.md").read_text().split("```python\n")[1].split("```")[0]
    (root / "mine.py").write_text(python)
    (root / "my-set.yaml").write_text("about: mine\nfeatures: [zc, height_range_c100, planarity_k20]\n")
    shutil.copy(streetmaker.directory() / "drive.parquet", root / "drive.parquet")
    page = (ROOT / "docs" / "street.md").read_text()
    street = page.split("```yaml\n")[1].split("```")[0].replace("[0, -40, 60, 40]", "[0, -40, 3, 40]")
    (root / "my-street.yaml").write_text(street.replace("gap: 3 ", "gap: 0.3 ").replace("rbf-svm", "forest"))
    rows = [r for r in page.split("begin,end,y0")[1].split("```")[0].splitlines()[1:] if r]
    (root / "labels.csv").write_text("\n".join(["begin,end,y0,y1,z0,z1,kind,class", *rows]) + "\n")
    assert fwclass("run", "my-survey.yaml", "--workers", "0", cwd=root).returncode in (0, 4)
    words = ("--model", "rows-dir", "--keep-rows", 50, "--workers", 0)
    assert fwclass("train", "my-survey.yaml", *words, cwd=root).returncode == 0
    assert fwclass("suggest", "runs/my-survey", "looked-at.gpkg", "--size", 5, cwd=root).returncode == 0
    for trees in ("train.trees=3", "train.trees=4"):
        words = ("run", "demo", "--out", "demo-run", "--workers", "0", *town, "--set", trees)
        assert fwclass(*words, cwd=root).returncode in (0, 4)
    shutil.copytree(root / "runs/my-survey/model", root / "forest-dir")
    (root / "checks.csv").write_text("x,y,z\n500040,5400020,202\n500050,5400010,202.5\n")
    contract = Layer("contract", box_wkb([Box(500_010, 5_400_010, 500_070, 5_400_030)]), {})
    write_gpkg([contract], root / "contract.gpkg", pyproj.CRS("EPSG:25832"))
    (root / "data" / "in").mkdir(parents=True)
    shutil.copytree(root / "runs" / "my-survey", root / "runs" / "other", symlinks=True)
    yield root


@pytest.mark.slow
@pytest.mark.parametrize("page", [p for p in PAGES if p.name not in WALKED and lines(p)], ids=lambda p: p.name)
def test_the_commands_of_a_page_run(page: Path, place: Path, tmp_path: Path) -> None:
    here = tmp_path / "here"
    shutil.copytree(place, here, symlinks=True)
    failed = []
    for line in lines(page):
        words = line.removeprefix("fwclass ")
        if any(re.search(pattern, words) for pattern in ELSEWHERE):
            continue
        ended = fwclass(*arguments(words, here), cwd=here)
        if ended.returncode not in ((0, 3, 4) if words.startswith("status") else (0, 4)):  # 3: stale, as the page says
            failed.append((line, ended.returncode, ended.stderr[-600:]))
    assert not failed, "\n".join(map(str, failed))


@pytest.mark.slow
def test_the_commands_of_the_report_run(place: Path, tmp_path: Path) -> None:
    here = tmp_path / "here"
    shutil.copytree(place, here, symlinks=True)
    page = (here / "demo-run" / "report.html").read_text(encoding="utf-8")
    written = (re.sub("<[^>]*>", "", c) for c in re.findall(r"<code>(.*?)</code>", page))
    commands = [c.removeprefix("fwclass ") for c in written if c != "fwclass view RUN"]  # it ends with Ctrl-C
    assert len(commands) == 3
    for words in commands:
        ended = fwclass(*words.replace("RUN", "demo-run").split(), cwd=here)
        assert ended.returncode == 0, (words, ended.stderr)


def arguments(words: str, here: Path) -> list[str]:
    """The words of a line, of this directory and of the size of a test."""
    for pattern, name in NAMES:
        words = re.sub(pattern, name, words)
    tiles = sorted(p.name.removesuffix(".copc.laz") for p in (here / "runs/other/laz/tiles").iterdir())
    if words.startswith("label checkout"):
        shutil.rmtree(here / "mend", ignore_errors=True)
    split = []
    for word in shlex.split(words.replace("12_34,12_35", ",".join(tiles[:2]))):
        quoted = f"'{word}'" in words
        split += sorted(str(p.relative_to(here)) for p in here.glob(word)) if "*" in word and not quoted else [word]
    command, _ = command_of(split)
    known = {name for parameter in command.params for name in parameter.opts}
    town = split[1:2] in (["demo"], ["city-1200m"]) or split[0] == "demo"
    settings = [w for s in (TOWN if town else QUICK) for w in ("--set", s)]
    if split[0] in ("run", "train", "select", "simulate", "demo") and "--set" in known:
        split += settings
    if "--overwrite" in known and split[0] != "view" and not (split[0] == "info" and "--waveforms" not in split):
        split.append("--overwrite")
    return [*split, *(("--workers", "0") if "--workers" in known and split[0] != "plan" else ())]
