"""Text from files is shown as text: in the pages, in the files that are delivered, and on the terminal."""

from __future__ import annotations

import io
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import rasterio
import yaml
from commandline import fwclass
from lasmaker import vlr, write_las
from pyproj import CRS
from rich.console import Console

from fwclass.classes import ClassDef
from fwclass.errors import ConfigError, InputError, set_words, system_error, visible
from fwclass.grid import Window
from fwclass.label.values import codes_of
from fwclass.publish.cog import write_cog
from fwclass.publish.figures import class_map
from fwclass.publish.files import whole_directory
from fwclass.publish.params import PublishParams
from fwclass.publish.report import environment, render_report
from fwclass.read.info import describe, info
from fwclass.run.progress import Display
from fwclass.store.atomic import write_json
from fwclass.store.run_store import Store

SCRIPT = "<script>alert(1)</script>\"'><img src=x onerror=alert(2)>"
ANSI = "\x1b[2J\x1b[31mred\x07\u202eevil\r"
"""Clears the screen, colours, rings, turns the writing around, and begins the line anew."""

RAW = re.compile(r"<script|<img src=x|onerror=alert\(2\)>", re.I)


def report() -> dict[str, object]:
    """A report with a text from a file wherever one can stand."""
    classes = [{"name": SCRIPT, "code": 2}, {"name": "b", "code": 6}]
    return {
        "survey": SCRIPT,
        "fwclass": SCRIPT,
        "seconds": 1.0,
        "classes": classes,
        "counts": {SCRIPT: 5, "b": 3},
        "config": {"survey": {"name": SCRIPT, "about": SCRIPT}},
        "input": {"files": [{"path": SCRIPT, "points": 1, "pulses": 1, "point_format": 9}], "faults": {SCRIPT: 3}},
        "outputs": {"laz": [f"laz/{SCRIPT}.laz", "javascript:alert(3)", "../../etc/passwd"], SCRIPT: [SCRIPT]},
        "stages": [{"name": SCRIPT, "parts": 1, "computed": 1, "skipped": 0, "failed": 0, "seconds": 1.0}],
        "accuracy": {
            "classes": [SCRIPT, "b"],
            "confusion": [[4, 1], [1, 2]],
            "overall_accuracy": 0.75,
            "kappa": 0.5,
            "producers_accuracy": [0.8, 0.7],
            "users_accuracy": [0.8, 0.7],
            "iou": [0.6, 0.5],
            "mean_iou": 0.55,
        },
    }


def test_the_report_shows_a_script_as_text(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    render_report(report(), {}, path)
    page = path.read_text()
    assert not RAW.search(page) and page.count("&lt;script&gt;") >= 8
    hrefs = re.findall(r'href="([^"]*)"', page)
    assert hrefs and all(h.startswith(("./", "#")) and ".." not in h for h in hrefs)


def test_the_report_writes_control_characters_out(tmp_path: Path) -> None:
    """A coordinate system's name, of a file's own record, turned the line of the page around that it stood in."""
    made = report()
    made["crs"] = made["survey"] = ANSI
    render_report(made, {}, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert not [c for c in ANSI if not c.isprintable() and c in page] and "\\u202eevil" in page


def test_every_template_escapes() -> None:
    """No template switches escaping off, for a value or for a block."""
    made = environment()
    assert made.autoescape is True
    folder = Path(made.loader.searchpath[0])  # type: ignore[union-attr]
    templates = sorted(folder.rglob("*.j2"))
    assert len(templates) >= 6
    for path in templates:
        text = path.read_text().replace("<style>{{ style | safe }}", "")  # the package's own
        assert not re.search(r"\|\s*safe|autoescape|Markup|<script", text), path
        assert not re.search(r"(href|src|style)=\{\{|\son\w+=", text), path
    code = "".join(p.read_text() for p in folder.rglob("*.py"))
    assert "Markup" not in code


def test_a_name_with_dollars_is_drawn_as_it_is(base: dict) -> None:
    """matplotlib takes what stands between two $ for a formula, and a broken one ends the drawing."""
    window = Window(1.0, 0, 0, 8, 8)
    codes = np.full((8, 8), 2, np.uint8)
    names = [{"name": r"cost $\frac{$ \q", "code": 2}, {"name": SCRIPT, "code": 6}]
    made = class_map(codes, window, names, PublishParams(**base["publish"]))
    assert made.startswith(b"\x89PNG")


def test_tags_of_a_raster_hold_a_script_as_text(tmp_path: Path, base: dict) -> None:
    params = PublishParams(**base["publish"])
    path = tmp_path / "a.tif"
    write_cog(
        np.full((8, 8), 2, np.uint8),
        Window(1.0, 0, 0, 8, 8),
        path,
        CRS.from_epsg(25832),
        params,
        nodata=0,
        names={2: SCRIPT},
        tags={"what": "]]></Item>" + SCRIPT},
    )
    with rasterio.open(path) as file:
        assert file.tags(1)["CLASS_2"] == SCRIPT and file.tags()["what"].endswith(SCRIPT)


def test_a_report_as_json_is_plain_ascii(tmp_path: Path) -> None:
    write_json(tmp_path / "report.json", {"name": ANSI, "more": [SCRIPT]})
    data = (tmp_path / "report.json").read_bytes()
    assert data.isascii() and not set(data) & (set(range(32)) - {10})
    assert json.loads(data) == {"name": ANSI, "more": [SCRIPT]}


@pytest.fixture()
def hostile_las(tmp_path: Path) -> Path:
    """A file whose header, records and coordinate system are full of control characters and markup."""
    wkt = CRS.from_epsg(25832).to_wkt("WKT1_GDAL").replace('PROJCS["ETRS89 / UTM zone 32N"', f'PROJCS["{ANSI}"')
    path = write_las(
        tmp_path / "a.las",
        [[0, 0, 0], [1, 1, 1]],
        point_format=6,
        keys=None,
        wkt=wkt,
        extra={"a\x1b[31m": ("u1", 1.0, [1, 2])},
    )
    data = bytearray(path.read_bytes())
    data[26:58] = ANSI.encode("utf-8")[:32].ljust(32, b"x")
    data[58:90] = (b"\x1b]0;title\x07\n  no faults found").ljust(32, b"y")
    path.write_bytes(data)
    return path


def controls(text: str) -> set[str]:
    return {c for c in text if not c.isprintable()} - {"\n", "\t"}


def test_info_writes_control_characters_out(hostile_las: Path) -> None:
    told = describe(info(hostile_las))
    assert not controls(told) and "\\x1b" in told
    assert "\n  no faults found" not in told.replace("\n  no faults found", "", told.endswith("\n  no faults found"))
    for words in ((), ("--json",)):
        ended = fwclass("info", hostile_las, *words)
        assert ended.returncode == 0 and not controls(ended.stdout + ended.stderr)


def test_errors_write_control_characters_out(tmp_path: Path) -> None:
    fault = InputError(f"what {ANSI}", where=tmp_path / ANSI, expected=ANSI, got=ANSI, do=ANSI)
    assert not controls(str(fault)) and "\\x1b[31m" in str(fault) and "\\u202e" in str(fault)
    path = tmp_path / "a\x1b[31m.las"
    path.write_bytes(b"LASF" + ANSI.encode())
    for words in (("info", path), ("run", "no\x1b[2Jsuch", "--out", tmp_path / "o")):
        ended = fwclass(*words)
        assert ended.returncode in (1, 2) and not controls(ended.stderr) and "\\x1b" in ended.stderr


@pytest.mark.parametrize(
    "words",
    [
        ("run", "demo", "--out"),
        ("plan", "demo", "--out"),
        ("train", "demo", "--out"),
        ("status",),
        ("history",),
        ("demo", "--out"),
        ("ground", "a.las"),
        ("ground", "a.las", "--dtm"),
        ("street", "simulate", "--out"),
    ],
)
def test_a_name_to_write_to_that_forges_lines_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    name = "o\nground          99 %\x1b]0;title\x07.tif"
    for place in (name, f"{name}/x"):
        ended = fwclass(*words, place)
        assert ended.returncode == 2 and not any(tmp_path.iterdir())
        assert not controls(ended.stderr) and "\nground" not in ended.stderr and "cannot be seen" in ended.stderr


@pytest.mark.parametrize(
    "words",
    [("ground",), ("normalize", "--method", "smrf"), ("features", "--features", "zc,echo_ratio_r100"), ("info",)],
)
def test_names_of_files_forge_no_line(tmp_path: Path, words: tuple[str, ...]) -> None:
    """A name may hold the end of a line and what looks like the next one."""
    name = "a\nground          99 %\x1b]0;title\x07\r\x9b31m\u202e"
    x, y = np.random.default_rng(0).uniform(0, 60, (2, 3000))
    path = write_las(tmp_path / f"{name}.las", np.c_[x, y, x * 0.1], point_format=6)
    output = () if words == ("info",) else (tmp_path / ("o.parquet" if words[0] == "features" else "o.las"),)
    ended = fwclass(words[0], path, *output, *words[1:])
    assert ended.returncode == 0, ended.stderr
    shown = ended.stdout + ended.stderr
    assert not controls(shown) and "\nground          99 %" not in shown and "\\x1b" in shown


@pytest.mark.parametrize("text", ["plain", "Straße – 漢字 é", "a b\tc\nd"])
def test_what_can_be_seen_stays(text: str) -> None:
    assert visible(text, "\n\t") == text


def test_progress_writes_control_characters_out_and_reads_no_markup() -> None:
    display = Display()
    out = io.StringIO()
    display.console = Console(file=out, color_system=None, width=200)
    display.say(f"[bold]{ANSI}[/nonsense]")
    assert "[bold]" in out.getvalue() and "[/nonsense]" in out.getvalue() and not controls(out.getvalue())


def test_what_a_run_directory_tells_of_failures_is_plain(tmp_path: Path) -> None:
    write_json(
        tmp_path / "store" / "failures" / "tile" / "1_1.json",
        {"stage": "tile", "part": "1_1", "key": "k", "message": f"first\n{ANSI}"},
    )
    ((failure, _),) = Store(tmp_path).failures.all().values()
    assert failure.message.startswith("first\n") and not controls(failure.message)


def test_a_record_with_markup_is_read_and_told(tmp_path: Path) -> None:
    path = write_las(tmp_path / "a.las", [[0, 0, 0]], point_format=6)
    data = path.read_bytes()
    start = int.from_bytes(data[96:100], "little")
    more = vlr("LASF_Spec", 3, ANSI.encode())
    head = bytearray(data[:start] + more)
    head[96:100] = len(head).to_bytes(4, "little")
    head[100:104] = (int.from_bytes(data[100:104], "little") + 1).to_bytes(4, "little")
    path.write_bytes(bytes(head) + data[start:])
    assert not controls(describe(info(path)))


def test_a_fault_names_what_the_user_named_not_what_is_written_beside_it(tmp_path: Path) -> None:
    target = tmp_path / "page"
    target.symlink_to(tmp_path / "gone" / "elsewhere")
    with pytest.raises(OSError) as fault, whole_directory(target):
        pass
    assert ".part" in str(fault.value)
    assert system_error(fault.value).where == str(target)
    for name in (".a.laz.host-12.part.laz", ".a.laz." + 32 * "0"):
        assert system_error(PermissionError(13, "no", f"/x/{name}")).where == "/x/a.laz"
    for name in ("/x/.a.laz.part", "/x/a.b", "/x/.hidden/y"):
        assert system_error(PermissionError(13, "no", name)).where == name


def test_a_line_of_a_file_does_not_pass_for_one_of_the_message() -> None:
    """The run that the note of a checkout names may have a line end in its name."""
    fault = InputError("no such run", where="a\nb", expected="a run", got="x\n  what to do: rm -rf /", do="check it")
    labels = [line for line in str(fault).splitlines() if re.match(r"  \S", line)]
    assert [line.split(":")[0].strip() for line in labels] == ["where", "expected", "got", "what to do"]


EVIL = [
    "$(touch PWN)",
    "`touch PWN`",
    "a; touch PWN",
    "a' b",
    'a" b',
    "a\nb",
    "\x1b[2J",
    "null",
    "12",
    "{a: b}",
    "Straße 7",
    "/scan",
    "",
]


@pytest.mark.parametrize("text", EVIL)
def test_words_that_a_user_may_copy_hold_no_command_of_a_file(text: str) -> None:
    """A class field's values and a layer's name stood between double quotes, or none."""
    for value, read in ((text, text), ({text: "null"}, {text: None})):
        words = shlex.split(str(InputError("a", do=set_words("survey.reference.layer", value))).partition("do: ")[2])
        assert words[0] == "--set" and len(words) == 2
        assert yaml.safe_load(words[1].partition("=")[2]) == read
    with pytest.raises(ConfigError) as fault:
        codes_of([text + "#"], {}, (ClassDef("ground", 2, (2,)),), "here")
    told = shlex.split(str(fault.value).partition("or null: ")[2])
    assert told[:1] == ["--set"] and yaml.safe_load(told[1].partition("=")[2]) == {text + "#": None}
