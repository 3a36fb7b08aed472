"""Remarks on a page: what they mean first, and what to set apart from that."""

import pytest

from fwclass.assess.remarks import Extent, remarks
from fwclass.publish.report import names_of, render_report, sentence, split_remark


@pytest.mark.parametrize(
    ("text", "said", "advice"),
    [
        ("no terrain at all", "no terrain at all", ""),
        ("rough (ground.cell), and wide (a.b=3, c.d): look", "rough, and wide: look", ""),
        ("too narrow: 25 m (assess.block): --set assess.block=54.", "too narrow: 25 m.", "--set assess.block=54."),
        ("one strip: alone (quality.strips=times cuts it)", "one strip: alone.", "quality.strips=times cuts it"),
        ("codes (3, 4): lost; --keep 3,4 (classify.keep=[3,4]) stays", "codes (3, 4): lost.", "--keep 3,4 stays"),
        (
            "two (see `fwclass info`) files. Mend survey.sources",
            "two files.",
            "Mend survey.sources; see `fwclass info`",
        ),
        ("a.las and b.gpkg differ; quality.html says how", "a.las and b.gpkg differ; quality.html says how", ""),
        ("--keep 3 lost its class", "--keep 3 lost its class", ""),
    ],
)
def test_a_remark_is_parted_from_what_to_set(text, said, advice):
    assert split_remark(text) == (said, advice)


def test_remarks_stand_on_a_page_as_sentences():
    assert sentence("the model learned from few") == "The model learned from few."
    assert sentence("strips lie apart.") == "Strips lie apart."
    assert sentence("Does it?") == "Does it?"


@pytest.mark.parametrize(
    "text",
    [
        "a second layer could be tried on 0 squares",
        "another echo follows at one delay",
        "breaklines lie more than 1 m below the ground",
        "every echo is of one pulse",
        "fitted times lie -3.34 ns from the vendor's locations",
        "hardly one of 6,000 echoes is the last of its pulse",
        "left out by survey.exclude: 3 source files, cut2.laz",
        "line 2 lies 0.090 m above line 1",
        "northern strips lie higher",
        "places lie on a lattice (a.las: x 100, y 100 m)",
        "returns below others of their pulse lie 0.3",
        "samples are cut off",
        "single returns of b.las have an intensity",
        "tried on 16 squares that neither layer had learned from",
        "values beyond what an extra byte holds",
        "wires are not looked for along lines (classify.lines)",
    ],
)
def test_words_begin_with_a_capital(text):
    assert sentence(text, FILES) == f"{text[0].upper()}{text[1:]}."


FILES = names_of(["strips/north.las", "old town.laz", "l.las"])


@pytest.mark.parametrize(
    "text",
    [
        "urban_7.laz: 3 returns",
        "p1 has no time",
        "survey.crs names another",
        "north lies above l",
        "north: no returns",
        "old town.laz lies 3 km from the nearest",
        "old town lies above north",
        "height_above_ground has no value",
        "strips/north has no time",
        "l lies above north",
        "x 5400120, y 500050 is 3.4° N",
        "gamma = 0.03 is the smallest that was tried",
        "bathymetry.enabled: no waveform shows a bottom",
    ],
)
def test_names_stay_as_they_are(text):
    assert sentence(text, FILES) == f"{text}."


def test_a_page_knows_its_files(tmp_path):
    told = ["north lies above south", "samples are cut off"]
    render_report({"input": {"files": [{"path": "north.las"}]}, "remarks": told}, {}, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "north lies above south." in page and "Samples are cut off." in page and "North lies" not in page


def test_no_remark_on_an_accuracy_speaks_of_settings_first(base, tmp_path):
    from fwclass import conf

    figures = {"blocks": 25, "pure_share": 0.95, "confusion": [[9, 1], [1, 9]], "kappa": 0.8, "intervals": None}
    extent, params = Extent(10_000, 300, {"17": 300}, 2.0, 60.0), conf.section("assess")
    told = [remarks({**figures, "blocks": 4}, extent, params)[0], *remarks(figures, extent, params)]
    assert len(told) == 6
    for text in told:
        said = split_remark(text)[0]
        assert "--set" not in said and "assess." not in said and "survey." not in said and len(said) > 40, said
    render_report({"remarks": told}, {}, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert page.count('class="advice">For the next run: ') == 3 and "or more.</span>" in page
