"""The report: complete, self-contained, escaped, and the same bytes for the same run."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from browser import seen
from defaults import BASE
from pagedriver import driven

from fwclass import conf
from fwclass.errors import several
from fwclass.grid import Window
from fwclass.publish.drawing import COORDINATE, DPI
from fwclass.publish.figures import SURE, class_map, relief, share_map
from fwclass.publish.params import PublishParams
from fwclass.publish.report import _as_yaml, render_report
from fwclass.publish.sections import measure, number, percent, quantity, seconds

PNG = b"\x89PNG\r\n\x1a\n-not-really"
EVIL = "<script>alert('x')</script>&\"'{{ 7 * 7 }}"
OBJECTS = {"reference": 31, "found": 30, "split": 2, "predicted": 29, "correct": 28, "merged": 1}
OBJECTS |= {"completeness": 30 / 31, "correctness": 28 / 29, "quality": None}
CLASSES = [{"name": "ground", "code": 2}, {"name": "building", "code": 6}]


def full(survey: str = "city") -> dict[str, Any]:
    return {
        "survey": survey,
        "fwclass": "0.1.0",
        "input": {
            "files": [{"path": "strips/a.las", "points": 1200, "pulses": 1000, "point_format": 9}],
            "faults": {"packet past the end": 3},
        },
        "counts": {
            "pulses": 1000,
            "echoes_decomposed": 1234,
            "echoes_in_tiles": 1234,
            "tiles": 4,
            "returns": 1200,
            "returns_without_packet": 3,
        },
        "stages": [
            {"name": "read", "parts": 4, "computed": 3, "skipped": 1, "seconds": 2.0, "peak_mib": 300, "rows": 99},
            {"name": "tile", "parts": 4, "computed": 4, "skipped": 0, "seconds": 8.0, "peak_mib": 400, "rows": 98},
        ],
        "classes": CLASSES,
        "accuracy": {
            "classes": ["ground", "building"],
            "confusion": [[90, 10], [5, 45]],
            "overall_accuracy": 0.9,
            "kappa": 0.7788,
            "producers_accuracy": [0.9, 0.9],
            "users_accuracy": [0.947, 0.818],
            "iou": [0.857, None],
            "mean_iou": 0.8,
            "type_i": 0.1,
            "type_ii": 0.1,
            "total_error": 0.1,
            "area": "one tile",
            "objects": {
                "cell": 0.75,
                "classes": [{"name": "building", **OBJECTS, "sizes": [{"from": 2.0, **OBJECTS}]}],
            },
        },
        "training": {"samples": {"ground": 500, "building": 400}, "trees": 100, "features": ["zc", "echo_ratio_r100"]},
        "distribution": {
            "zc": {
                "ground": {"p5": 0.0, "p25": 0.01, "p50": 0.05, "p75": 0.1, "p95": 0.3, "n": 900},
                "building": {"p5": 2.9, "p25": 4.0, "p50": 6.0, "p75": 8.0, "p95": 11.0, "n": 300},
            },
            "width": {"ground": {"p5": None, "p25": None, "p50": None, "p75": None, "p95": None, "n": 0}},
        },
        "place": {
            "crs": "ETRS89 / UTM zone 32N" if survey == "city" else survey,
            "code": "EPSG:25832",
            "bounds": [0, 0, 200, 100],
            "flown": ["2021-03-17", "2021-03-18"],
            "area": 20000.0,
            "density": 4.25,
        },
        "sureness": {
            "classes": [{"name": c["name"], "code": c["code"], "echoes": 10, "confidence": 0.9} for c in CLASSES],
            "tiles": [{"tile": "1_2", "file": "laz/tiles/1_2.copc.laz", "confidence": 0.61, "echoes": 1200}],
        },
        "automation": [[0.5, 1.0, 0.9], [0.8, 0.7, 0.97], [1.0, 0.2, 1.0]],
        "reliability": {
            "confidence": 0.91,
            "right": 0.93,
            "error": 0.025,
            "steps": [[0.55, 0.1, 0.6], [0.97, 0.9, 0.97]],
            "without_class": 0,
        },
        "waves": [
            {
                "strip": 3,
                "pulse": 77,
                "start": 0.0,
                "spacing": 1.0,
                "samples": [10, 11, 40, 90, 42, 12, 10],
                "baseline": 10.2,
                "echoes": [[3.0, 80.0, 2.1]],
            }
        ],
        "areas": {"train": [[0, 0, 100, 100]], "test": [[100, 0, 200, 100]]},
        "outputs": {
            "laz": [f"laz/tiles/{i}.copc.laz" for i in range(12)],
            "parquet": [],
            "rasters": ["rasters/dtm.tif"],
        },
        "config": {"tile": {"size": 100.0}},
        "seconds": 12.5,
    }


class Page(HTMLParser):
    """Tags in balance, the text, and every address the page names."""

    VOID = frozenset({"meta", "img", "br", "input"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.text = ""
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        for name, value in attrs:
            assert not name.startswith("on")
            if name in ("src", "href"):
                self.addresses.append(value or "")
            if name == "id":
                self.ids.append(value or "")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] != "style":
            self.text += " " + data


def rendered(report: dict[str, Any], tmp_path: Path, figures: dict[str, bytes] | None = None) -> tuple[str, Page]:
    render_report(report, figures or {}, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    return text, Page(text)


def test_everything_is_there(tmp_path: Path) -> None:
    text, page = rendered(full(), tmp_path, {"relief": PNG, "map": PNG})
    layers = ["layer-map", "layer-relief"]
    after = ["training", "distribution", "waveforms", "input", "stages", "outputs", "config"]
    assert page.ids == ["maps", *layers, "accuracy", "confidence", "next", *after]
    assert {f"#{i}" for i in page.ids if i not in layers} == {a for a in page.addresses if a.startswith("#")}
    said = re.sub(r"\s+", " ", page.text)
    for words in (
        "90.0 %",
        "0.779",
        "type II error",
        "packet past the end",
        "All 1 234 echoes are in tiles",
        "strips/a.las",
        "≈ 0 m",
        "3–10 m",
        "size: 100.0",
        "one tile",
        "in cells of 0.75 m",
        "building all 31 30 2 29 28 1 96.8 96.6 –",
        "from 2 m² 31",
        "echo ratio ER, r = 1 m",
        "12.5 s",
        "EPSG:25832",
        "4.2 echoes per m²",
        "90.0 % of the test echoes have the right class",
        "strip 3, pulse 77: 1 echo",
        "Tile 1_2",
        "4 more",
    ):
        assert words in said, words
    assert text.index('alt="Classes:') < text.index('alt="Terrain:'), "the classes come first"
    assert text.count("width:100.0%") == 1 and text.count("width:25.0%") == 1, "bars of 8 s and 2 s"


def test_the_time_is_that_of_all_parts_too_where_earlier_runs_made_some(tmp_path: Path) -> None:
    report = full()
    made = {**report["stages"][0], "seconds": 90.0, "skipped": 0}
    for skipped, words in ((0, ["6.0 s</b><span>time<"]), (3, ["6.0 s</b><span>time of the last run<", "3 min 00 s<"])):
        stages = [made, {**made, "skipped": skipped}]
        render_report({**report, "seconds": 6.0, "stages": stages}, {}, tmp_path / "report.html")
        facts = (tmp_path / "report.html").read_text().partition('class="facts"')[2].partition("<nav")[0]
        assert all(word in facts for word in words) and ("of all parts" in facts) == bool(skipped), facts


def test_a_remark_is_told_once(tmp_path: Path) -> None:
    report = full()
    report["accuracy"]["remarks"] = ["few echoes were tested", "of the matrix alone"]
    report["remarks"] = ["few echoes were tested", "an empty file", "an empty file"]
    said = rendered(report, tmp_path)[1].text
    assert [said.count(t) for t in ("Few echoes were tested.", "An empty file.", "Of the matrix alone.")] == [1, 1, 1]


def test_letters_of_maps_can_be_read_on_a_telephone(tmp_path: Path) -> None:
    """A picture tells how wide it is, and is shown at so much of it that letters of axes have nine pixels."""
    png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + (1312).to_bytes(4) + (900).to_bytes(4)
    text, _ = rendered(full(), tmp_path, {"map": png, "relief": png})
    assert text.count('style="--wide: 1312px"') == 2
    share = re.search(r"figure > img \{ width: max\(100%, var\(--wide\) \* (\.\d+)\)", text)
    assert share is not None and float(share[1]) * COORDINATE / 72 * DPI >= 9


def test_frames_are_spoken_of_where_they_are_drawn(tmp_path: Path) -> None:
    text, _ = rendered(full(), tmp_path, {"map": PNG, "confidence": PNG, "relief": PNG})
    captions = dict(re.findall(r'class="layer layer-(\w+)">.*?<figcaption>(.*?)</figcaption>', text, re.S))
    assert {name: "dashed frames" in c for name, c in captions.items()} == {
        "map": True,
        "confidence": True,
        "relief": False,
    }


def test_every_density_says_what_it_is_of(tmp_path: Path) -> None:
    report = full()
    report["config"] = {"publish": {"class_cell": 0.5}}
    said = rendered(report, tmp_path)[1].text
    assert "0.020 km², by cells of 0.5 m" in said and "4.2 echoes per m² of this area, noise among them" in said


@pytest.mark.parametrize("name", ["Straße 😀 " * 20, "x" * 300, "on", "1.0", "a: b # c", "two\nlines\n", None, 1e300])
def test_the_configuration_is_shown_as_python_writes_it(name: Any) -> None:
    """libyaml escapes a 😀."""
    config = {"survey": {"name": name, "classes": [{"name": name, "codes": [[1, 2], []]}]}, "z": {}, "a": BASE}
    assert _as_yaml(config) == yaml.safe_dump(config, sort_keys=False, allow_unicode=True, width=100)


def test_counts_have_their_number(tmp_path: Path) -> None:
    report = full()
    report["counts"]["tiles"] = 1
    text, page = rendered(report, tmp_path)
    assert "<b>1</b><span>tile</span>" in text and "in 1 tile." in page.text
    assert "1 tiles" not in page.text and (several(1, "tile"), several(1200, "tile")) == ("1 tile", "1,200 tiles")


def test_codes_that_strips_have_in_place_of_others_are_told(tmp_path: Path) -> None:
    report = full()
    report["classes"] = [*CLASSES, {"name": "car", "code": 64}]
    report["legacy_codes"] = {"strips": ["a", "b"], "written": {"64": 31}}
    said = rendered(report, tmp_path)[1].text
    assert "a, b have 31 for car 64, as their points hold codes up to 31;" in said
    assert "hold codes up to" not in rendered(full(), tmp_path)[1].text


def test_a_run_without_a_classifier_is_about_terrain_or_quality(tmp_path: Path) -> None:
    codes = [{"name": n, "code": c, "codes": [c]} for n, c in (("unclassified", 1), ("ground", 2), ("high noise", 18))]
    report = {**full(), "classes": codes, "model": {"path": None, "features": [], "classes": codes}, "accuracy": None}
    facts = {"method": "smrf", "echoes": 1234, "ground": 700, "noise": 0, "without_terrain": 0, "block": 256.0}
    report |= {"training": None, "ground": facts}
    text, page = rendered(report, tmp_path, {"map": PNG, "relief": PNG})
    assert "Lidar terrain report" in page.text and "700 of them ground" in page.text
    assert "classification report" not in page.text and "why an echo has its class" not in page.text
    assert text.index('for="layer-relief"') < text.index('for="layer-map"')
    assert re.search(r'id="ground">\s*<details class="part" open>', text)
    text, page = rendered({**report, "outputs": {"quality": ["quality.html"]}, "classes": []}, tmp_path)
    assert "Lidar quality report" in page.text
    text, page = rendered(full(), tmp_path, {"map": PNG, "relief": PNG})
    assert "Lidar classification report" in page.text
    assert text.index('for="layer-map"') < text.index('for="layer-relief"')


def test_what_to_do_next_has_commands(tmp_path: Path) -> None:
    report = full() | {"failed": [{"stage": "read", "part": "a", "message": ""}]}
    text, page = rendered(report, tmp_path)
    commands = [" ".join(Page(c).text.split()) for c in re.findall(r"<code>(.*?)</code>", text)]
    assert commands == [
        "fwclass status RUN",
        "fwclass view RUN",
        "fwclass view RUN --worklist unsure.gpkg",
        "fwclass label checkout RUN mend --least-sure 3",
        "fwclass suggest RUN places.gpkg",
    ]
    assert "RUN is the directory that this page lies in" in page.text and "1 part failed" in page.text


def test_nothing_is_fetched(tmp_path: Path) -> None:
    text, page = rendered(full(), tmp_path, {"map": PNG})
    assert all(a.startswith(("data:image/png;base64,", "./", "#")) for a in page.addresses) and page.addresses
    assert "http" not in text.replace("http-equiv", "") and "@import" not in text and "url(" not in text
    assert "<script" not in text


def test_texts_from_files_are_escaped(tmp_path: Path) -> None:
    report = full(EVIL)
    report["input"]["files"][0]["path"] = EVIL
    report["input"]["faults"] = {EVIL: 1}
    report["accuracy"]["area"] = EVIL
    report["accuracy"]["classes"] = [EVIL, "b"]
    report["distribution"][EVIL] = {EVIL: {"p5": 1, "n": 1}}
    report["outputs"] = {EVIL: [EVIL, "javascript:alert(1)", "/etc/passwd", "../up.laz", "laz/a b&c.laz"]}
    report["config"] = {EVIL: EVIL}
    report["stages"][0]["name"] = EVIL
    report["training"]["features"] = [EVIL]
    report["classes"] = [{"name": EVIL, "code": 3}]
    text, page = rendered(report, tmp_path, {EVIL: PNG})
    assert "<script" not in text and "49" not in re.findall(r"alert\('x'\).{0,30}", page.text)
    links = [a for a in page.addresses if not a.startswith(("data:", "#"))]
    assert "./laz/a%20b%26c.laz" in links and all(a.startswith("./") for a in links)
    assert not any("javascript" in a or "passwd" in a or ".." in a for a in links)


@pytest.mark.parametrize("key", sorted(full()))
@pytest.mark.parametrize("empty", ["missing", None])
def test_a_section_without_data_is_left_out(key: str, empty: Any, tmp_path: Path) -> None:
    report = full()
    if empty == "missing":
        del report[key]
    else:
        report[key] = None
    _, page = rendered(report, tmp_path)
    section = {"input": None, "counts": None}.get(key, key)
    assert section is None or section not in page.ids
    assert "None" not in page.text and "nan" not in page.text


def test_an_empty_report_is_a_page(tmp_path: Path) -> None:
    _, page = rendered({}, tmp_path)
    assert page.ids == []


def test_a_lost_echo_is_shown(tmp_path: Path) -> None:
    report = full()
    report["counts"]["echoes_in_tiles"] = 1230
    _, page = rendered(report, tmp_path)
    assert "not all in tiles" in page.text and "4 differ" in page.text


def test_a_survey_of_returns_alone_has_no_counts_of_waveforms(tmp_path: Path) -> None:
    report, whole = full(), rendered(full(), tmp_path)[1].text
    report["counts"] = {**report["counts"], "pulses": 0, "returns_without_packet": 0, "returns": 1234}
    said = rendered(report, tmp_path)[1].text
    for words in ("pulses with waveforms", "returns without packet", "echoes decomposed"):
        assert words in whole and words not in said, words
    assert "All 1\u202f234 echoes are in tiles" in said and "1 source file gave 1\u202f234 echoes" in said


def test_failed_parts_are_shown_only_where_there_are_any(tmp_path: Path) -> None:
    assert "failed" not in rendered(full(), tmp_path)[1].text
    report = full()
    report["stages"][0]["failed"] = 2
    report["failed"] = [
        {"stage": "publish-strip", "part": "a", "message": "class code 67 does not fit\n  where: a.las"},
        {"stage": "publish-strip", "part": "b<i>", "message": ""},
    ]
    text = rendered(report, tmp_path)[1].text
    assert "This delivery is not whole: 2 parts failed (publish-strip a, publish-strip b<i>)" in text
    assert "The first: class code 67 does not fit. Mend" in text


def test_notes_on_training_are_told(tmp_path: Path) -> None:
    report = full()
    report["training"] |= {"out_of_bag": 0.931, "notes": ["few samples of building"]}
    said = rendered(report, tmp_path)[1].text
    assert "Out-of-bag accuracy 93.1 %" in said and "Few samples of building." in said


def test_the_curve_of_a_selection_is_drawn(tmp_path: Path) -> None:
    report = full()
    steps = [{"size": n, "accuracy": 0.8 + 0.02 * n, "accuracy_std": 0.01} for n in (1, 2, 4)]
    report["selection"] = {"method": "forward", "pick": "best", "survey": "<b>town</b>", "steps": steps}
    report["model"] = {"features": ["a", "b"]}
    text, page = rendered(report, tmp_path)
    assert "How many features are enough" in page.text and "The dot is this model: 2." in page.text
    assert "89.0 %" in page.text and "81.0 %" in page.text and "<b>town</b>" not in text
    report["model"] = {"features": ["a", "b", "c"]}
    assert "The dot" not in rendered(report, tmp_path)[1].text, "another set than any on the curve"
    report["selection"] = None
    assert "How many features" not in rendered(report, tmp_path)[1].text


def test_a_classifier_that_is_no_forest_has_its_name(tmp_path: Path) -> None:
    report = full()
    report["training"] |= {"trees": None, "method": "rbf-svm"}
    said = rendered(report, tmp_path)[1].text
    assert "Classifier: RBF SVM." in said and "The RBF SVM learned from 900" in said and "forest" not in said


def test_unclassified_echoes_get_a_column(tmp_path: Path) -> None:
    report = full()
    report["accuracy"]["unclassified"] = [7, 0]
    _, page = rendered(report, tmp_path)
    assert "none" in page.text and " 107 " in page.text


def test_same_run_same_bytes(tmp_path: Path) -> None:
    first, _ = rendered(full(), tmp_path, {"map": PNG})
    assert first == rendered(full(), tmp_path, {"map": PNG})[0]


def test_numbers_are_written_for_reading() -> None:
    assert number(1234567) == "1\u202f234\u202f567" and number(None) == "–"
    assert quantity(5_912_331) == "5.91\u202fM" and quantity(None) == ""
    assert percent(0.9166) == "91.7" and percent(float("nan")) == "" and percent(None) == ""
    assert (seconds(5.25), seconds(59.99), seconds(245), seconds(7810)) == (
        "5.2 s",
        "1 min 00 s",
        "4 min 05 s",
        "2 h 10 min",
    )
    assert [measure(v) for v in (0, 3.14159, 12.345, 1234.5, 0.0125, 2e-5, None, float("nan"))] == [
        "0",
        "3.14",
        "12.3",
        "1234",
        "0.013",
        "2.00e-05",
        "–",
        "–",
    ]


@pytest.mark.slow
def test_a_narrow_window_says_that_columns_follow(tmp_path: Path) -> None:
    rendered(full(), tmp_path)
    with driven() as page:
        page.open((tmp_path / "report.html").as_uri())
        page.until("!!document.querySelector('.matrix')")
        for width in (1280, 390):
            page.size(width)
            said = page.run("getComputedStyle(document.querySelector('.sideways')).display") != "none"
            table = "document.querySelector('.matrix').parentElement"
            assert page.run(f"{table}.scrollWidth > {table}.clientWidth") == said == (width == 390)
            page.run(f"{table}.scrollLeft = 100")
            assert page.run("document.querySelector('.matrix tbody th').getBoundingClientRect().left") >= 0


def test_the_tints_of_the_terrain_have_their_heights_beside_them(tmp_path: Path) -> None:
    window = Window(1.0, 0, 0, 30, 28)
    params = PublishParams(**conf.section("publish").model_dump())
    heights = (-1.0, 9.0)
    picture = relief(np.full(window.shape, 3.0, np.float32), window, params, heights, aside=False)
    render_report({"survey": "s"}, {"relief": picture}, tmp_path / "report.html", heights)
    told = re.findall(r"</span>(-?[\d.]+ m)</span>", (tmp_path / "report.html").read_text())
    assert told == ["-1.0 m", "2.5 m", "5.5 m", "9.0 m"]


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 390])
def test_it_fits_its_window_and_prints(width: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    window = Window(1.0, 0, 0, 300, 280)
    params = PublishParams(**conf.section("publish").model_dump())
    codes = rng.choice(np.array([0, 2, 6], np.uint8), window.shape)
    figures = {
        "map": class_map(codes, window, CLASSES, params, aside=False),
        "confidence": share_map(rng.random(window.shape).astype(np.float32), window, params, SURE),
    }
    report = full("word " * 30 + "averylongwordwithoutanyspace" * 6)
    boxes = {"p5": 1.0, "p25": 2.0, "p50": 3.0, "p75": 4.0, "p95": 5.0, "n": 9}
    report["distribution"] = {f"height_std_c{k}": {"ground": boxes, "building": boxes} for k in range(1, 64)}
    report["stages"] = [{**report["stages"][0], "name": f"stage-{k}"} for k in range(30)]
    render_report(report, figures, tmp_path / "report.html")
    page = seen(tmp_path / "report.html", width)
    assert page.width <= width, "no sideways scroll"
    assert page.height <= (6000 if width == 1280 else 12_000)
    assert page.requests == [] and page.pdf.startswith(b"%PDF")
    assert (tmp_path / "report.html").stat().st_size <= 4 << 20
