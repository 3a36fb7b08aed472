"""Parts of the papers' pages: printed tables, texts that come from outside, what a page says in words."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from fwclass.conf.papers import check_printed, paper
from fwclass.errors import ConfigError
from fwclass.publish import drawing, selection_curves
from fwclass.publish.papers import page, plots, scene, tables
from fwclass.publish.papers.page import _claims
from fwclass.publish.sections import unit_of
from fwclass.study.papers import fan_claims, shi_claims, xiong_claims
from fwclass.study.papers.claims import of_gain
from fwclass.study.papers.shi_scenes import busiest
from fwclass.study.papers.xiong import importances, radii

CLASSES = [{"name": "ground", "code": 2}, {"name": "building", "code": 6}, {"name": "vegetation", "code": 5}]


def test_printed_tables_of_fan_agree_with_their_own_percentages() -> None:
    """Rows are the reference: only then do the printed figures come out; the misprint of m = 3 is the one exception."""
    printed = paper("fan2013")
    for m, one in [*printed["splits"].items(), ("svm", printed["svm"])]:
        matrix = np.array(one["confusion"])
        assert 100 * np.trace(matrix) / matrix.sum() == pytest.approx(one["overall"], abs=0.1)
        producers = 100 * np.diag(matrix) / matrix.sum(axis=1)
        wrong = np.abs(producers - one["producers"]) > 0.11
        assert wrong.tolist() == [False, False, m == "3"]
    matrix = np.array(printed["splits"]["3"]["confusion"])
    matrix[2, 1] = 438
    assert matrix[2].sum() == np.array(printed["splits"]["4"]["confusion"])[2].sum()
    assert 100 * matrix[2, 2] / matrix[2].sum() == pytest.approx(88.2, abs=0.05)


def test_survivors_of_xiong_are_the_26_that_it_names() -> None:
    printed = paper("xiong2018")
    assert sum(map(len, printed["radii"].values())) + 1 == printed["selection"]["chosen"]
    known = {base for group in printed["groups"].values() for base in group}
    assert {base for bases in printed["radii"].values() for base in bases} <= known


def test_every_printed_claim_is_tested() -> None:
    assert list(paper("fan2013")["claims"]) == list(fan_claims.CLAIMS)
    assert list(paper("xiong2018")["claims"]) == list(xiong_claims.CLAIMS)
    assert list(paper("shi2019")["claims"]) == list(shi_claims.CLAIMS)


@pytest.mark.parametrize("name", ["fan2013", "shi2019", "xiong2018"])
def test_a_text_cut_at_its_comma_is_refused(name: str) -> None:
    """`{claim: Trees below, buildings above, figure: x}` is the key "buildings above" with null in YAML."""
    printed = paper(name)
    first = next(iter(printed["claims"]))
    cut = {**printed, "claims": {**printed["claims"], first: {**printed["claims"][first], "buildings above": None}}}
    with pytest.raises(ConfigError, match=f"claims.{first}.buildings above"):
        check_printed(name, cut, "here")
    with pytest.raises(ConfigError, match="tables"):
        check_printed(name, {**printed, "tables": 1}, "here")


def test_every_claim_of_fan_is_told_whole() -> None:
    assert paper("fan2013")["claims"]["tree_ratio"]["claim"].endswith("that of buildings and ground 100 %")


def test_a_printed_matrix_gets_the_figures_of_its_counts() -> None:
    made = tables.matrices(
        {"classes": ["a", "b"], "confusion": [[8, 2], [1, 9]], "kappa": 0.7}, CLASSES[:2], [[3, 1], [2, 4]]
    )
    told = dict(made["paper"]["totals"])
    assert told["overall accuracy"] == "70.0 %"
    assert told["kappa"] == "0.400"  # agreed 0.7, by chance 0.5
    assert made["paper"]["rows"][0]["producers_accuracy"] == "75.0"
    assert tables.matrices({"classes": ["a"], "confusion": [[1]]}, CLASSES[:1], [[3, 1], [2, 4]])["paper"] is None


def test_differences_without_an_interval_say_so() -> None:
    part = {"value": -0.01234, "low": None, "high": None}
    told = tables.difference(dict.fromkeys(("overall_accuracy", "kappa", "mean_iou"), part))
    assert (told["overall_accuracy"], told["overall_accuracy_span"]) == ("−1.23", "–")


@pytest.mark.parametrize(
    ("verdicts", "told"),
    [
        (["holds"], "1 holds"),
        (["holds", "holds", "not comparable"], "2 hold, 1 cannot be compared"),
        (["holds", "undecided"], "1 holds, 1 is undecided"),
        (["undecided", "undecided", "does not hold"], "1 does not hold, 2 are undecided"),
    ],
)
def test_verdicts_are_counted_in_words(verdicts: list[str], told: str) -> None:
    assert _claims({"claims": [{"verdict": v} for v in verdicts]})["told"] == told


def test_short_times_that_differ_are_written_apart() -> None:
    """`0.3 to 0.3 s` stood beside "holds"."""
    times = {"svm": {"train": 0.30, "test": 0.02, "test_rows": 6891}, "nn_svm": {"train": 0.27, "test": 0.01}}
    text, told, _ = shi_claims._trimming_time({"times": times, "steps": {n: {"vectors": 9} for n in times}})
    assert (text, told) == ("0.32 to 0.28 s", "holds")


def test_a_time_has_as_many_decimals_as_count() -> None:
    assert [tables.seconds_of(s) for s in (397.4, 27.46, 0.372, 0.0042)] == ["397 s", "27.5 s", "0.37 s", "0.004 s"]


def test_units_are_written_as_on_maps() -> None:
    names = ("density_c100", "height_variance_r100", "inclination_r100", "amplitude", "unknown")
    assert [unit_of(n) for n in names] == ["1/m²", "m²", "°", "DN", ""]


def test_times_of_thinning_have_numbers_on_their_axis(monkeypatch: pytest.MonkeyPatch) -> None:
    """Powers of ten stood there as `$\\mathdefault{10^{1}}$`."""
    drawn: list[Figure] = []
    monkeypatch.setattr(selection_curves, "png", lambda figure: drawn.append(figure) or drawing.png(figure))
    times = dict(zip(("total", "features", "vote", "follow"), (53.0, 52.0, 0.2, 0.01), strict=True))
    steps = [{"rate": r, "accuracy": 0.9, "accuracy_std": 0.01, "microseconds": times} for r in (1.0, 0.1)]
    selection_curves.draw_rates(steps, 0.1, "")
    labels = [text.get_text() for text in drawn[0].axes[1].get_yticklabels()]
    assert {"0.01", "0.1", "1", "10"} <= set(labels), labels


def test_every_picture_of_a_page_has_a_telephone_s_width() -> None:
    """Without it the rule of narrow windows is void, and a chart is as wide as its pixels, twice what is meant."""
    for template in Path(page.__file__).parent.glob("*.html.j2"):
        for found in re.findall(r"<figure[^>]*><img src=[^>]*>", template.read_text(encoding="utf-8")):
            assert "| width | xmlattr" in found, (template.name, found)


def _pair(value: float, low: float | None, high: float | None) -> dict:
    return {"overall_accuracy": {"value": value, "low": low, "high": high}}


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (0.001, 0.02, "holds"),
        (-0.001, 0.02, "does not hold"),
        (-0.03, -0.01, "does not hold"),
        (None, None, "not comparable"),
    ],
)
def test_a_gain_holds_only_beyond_chance(low: float | None, high: float | None, verdict: str) -> None:
    facts = {"thesis": {"seeds": [1]}, "differences": {"with-1/without-1": _pair(0.01, low, high)}}
    assert fan_claims.CLAIMS["waveform"](facts)[1] == verdict
    facts = {
        "chosen": ["a"],
        "candidates": ["a", "b"],
        "differences": {"rf_selected/rf": _pair(0.01, low, high)},
        "strategies": {k: {"overall_accuracy": 0.9} for k in ("rf_selected", "rf")},
        "printed": {"strategies": {"rf_selected": {"overall": 98.0}, "rf": {"overall": 94.0}}},
    }
    assert xiong_claims.CLAIMS["selection_helps"](facts)[1] == verdict


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (0.001, 0.005, "holds"),
        (-0.01, 0.03, "undecided"),
        (-0.01, 0.01, "does not hold"),
        (-0.03, -0.01, "does not hold"),
        (-0.03, 0.0, "does not hold"),
    ],
)
def test_a_gain_is_undecided_where_nought_and_the_papers_figure_are_both_possible(low, high, verdict) -> None:
    assert of_gain({"low": low, "high": high}, 0.014) == verdict


def test_a_selection_that_keeps_all_features_tells_nothing() -> None:
    facts = {"chosen": ["a"], "candidates": ["a"], "differences": {"rf_selected/rf": _pair(0.0, 0.0, 0.0)}}
    for name in ("selection_helps", "train_time", "test_time"):
        assert xiong_claims.CLAIMS[name](facts)[1] == "not comparable"


def test_without_waveforms_the_thesis_is_not_comparable() -> None:
    assert fan_claims.CLAIMS["waveform"]({"thesis": None})[1] == "not comparable"


def _xiong_facts(names: list[str]) -> dict:
    """Facts of a run by `names`, all of equal worth; only what the claims on features look at."""
    drop = {n: {"mean": 0.01, "std": 0.0} for n in names}
    printed = paper("xiong2018")
    return {
        "candidates": names,
        "chosen": names,
        "printed": printed,
        "importance": importances({"drop": drop, "repeats": 1}, printed["groups"]),
        "radii": radii(names, names, printed["radii"]),
        "strategies": {"rf_selected": {"omission": {"ground": 0.1}}},
        "thinning": {"lowest": 1.0, "steps": [{"rate": 1.0, "accuracy": 0.9}]},
    }


@pytest.mark.parametrize(
    ("names", "claim", "why"),
    [
        (["zc", "amplitude"], "height_statistics", "height statistics"),
        (["zc", "amplitude"], "echoes", "echoes"),
        (["zc", "amplitude"], "nh_first", "height above ground"),
        (["zc", "amplitude"], "larger_radii", "no candidate has a radius"),
        (["zc", "egi_r50"], "larger_radii", "one radius"),
        (["zc", "egi_r50"], "echoes", "too few kinds"),
        (["height_above_ground"], "nh_first", "only candidate"),
        (["zc", "amplitude"], "building_omission", "building"),
        (["zc", "amplitude"], "thinning", "select.rates"),
    ],
)
def test_claims_of_xiong_on_features_that_a_run_lacks_are_not_comparable(
    names: list[str], claim: str, why: str
) -> None:
    told = xiong_claims.CLAIMS[claim](_xiong_facts(names))
    assert told[1] == "not comparable"
    assert why in told[2]


@pytest.mark.parametrize(
    ("names", "claims"),
    [
        (
            ["inclination_r100", "echo_ratio_r50"],
            ["zc_alone", "steps", "backscatter", "best_set", "ground_zc", "width"],
        ),
        (["zc", "echo_number", "echo_ratio_r50"], ["steps", "backscatter", "best_set", "slopes", "amplitude"]),
        (["zc", "backscatter"], ["steps", "best_set", "tree_ratio"]),
    ],
)
def test_claims_of_fan_on_features_that_a_run_lacks_are_not_comparable(names: list[str], claims: list[str]) -> None:
    steps = [{"tried": [n], "accuracy": 0.5 + 0.1 * k} for k, n in enumerate(names)]
    curve = {"steps": steps, "candidates": names, "chosen": names}
    box = dict.fromkeys(("p5", "p25", "p50", "p75", "p95"), 1.0)
    facts = {
        "features": names,
        "classes": CLASSES,
        "printed": paper("fan2013"),
        "selection": {"paper": curve, "best": curve},
        "distribution": {n: {"ground": box, "building": box} for n in names},
        "thesis": None,
        "splits": {"2": {"overall_accuracy": 0.9}},
        "every_feature": {"overall_accuracy": 0.9},
    }
    for claim in [*claims, "split", "waveform", "accuracy"]:
        told = fan_claims.CLAIMS[claim](facts)
        assert told[1] == "not comparable", claim
        assert told[2]
    if names[0] == "zc":
        assert fan_claims.CLAIMS["zc_alone"](facts)[1] == "does not hold"


def test_importances_are_scaled_to_the_first_and_summed_by_kind() -> None:
    drop = {
        "egi_r50": {"mean": 0.02, "std": 0.001},
        "egi_r100": {"mean": 0.01, "std": None},
        "height_above_ground": {"mean": 0.04, "std": 0.002},
    }
    made = importances({"drop": drop, "repeats": 2}, paper("xiong2018")["groups"])
    assert [(r["name"], r["score"]) for r in made["rows"]] == [
        ("height_above_ground", 100.0),
        ("egi_r50", 50.0),
        ("egi_r100", 25.0),
    ]
    assert made["groups"] == {"normalised height": 100.0, "echoes": 75.0}


def test_survivors_are_counted_at_their_radius() -> None:
    names = ["height_above_ground", "egi_r50", "egi_r100", "height_std_r100", "planarity_k20"]
    made = radii(names, ["height_above_ground", "height_std_r100"], {"0.5": ["egi"], "1.0": [], "1.5": ["ebi"]})
    assert [(r["radius"], r["ours"], r["of"], r["paper"]) for r in made] == [
        (0.5, [], 1, ["egi"]),
        (1.0, ["height_std"], 2, []),
        (1.5, [], 0, ["ebi"]),
    ]


def test_plots_draw_what_is_missing_as_nothing_and_repeat_to_the_byte() -> None:
    box = {"p5": 0.0, "p25": 1.0, "p50": 2.0, "p75": 3.0, "p95": 4.0}
    made = {"zc": {"ground": box, "building": dict.fromkeys(box)}, "echo_ratio_r100": {"ground": box}}
    first = plots.draw_distribution(made, paper("fan2013")["distribution"])
    assert first == plots.draw_distribution(made, paper("fan2013")["distribution"])
    assert Image.open(io.BytesIO(first)).size[0] > 800
    part = {"value": 0.01, "low": None, "high": None}
    found = dict.fromkeys(("overall_accuracy", "kappa", "mean_iou"), part)
    assert plots.draw_thesis([("1", found)])[:4] == b"\x89PNG"


def test_squares_that_are_drawn_are_those_of_most_boundary_and_apart() -> None:
    counts = {(0, 0): 9, (0, 1): 8, (5, 5): 3, (9, 9): 0, (2, 0): 3}
    assert busiest(counts) == [(0, 0), (2, 0)]
    assert busiest({(0, 0): 0}) == []


def test_a_square_is_drawn_with_what_it_lacks() -> None:
    """No height anywhere, a label that is no class, no echo at the boundary: drawn, and the same bytes again."""
    n, r = 200, np.random.default_rng(0)
    echoes = {name: r.uniform(0, 10, n) for name in "xyz"} | {
        "ground": r.random(n) < 0.5,
        "height_above_ground": np.full(n, np.nan, np.float32),
        "reference": r.choice([0, 2, 6], n).astype(np.uint8),
        "coarse_class": r.choice([2, 6], n).astype(np.uint8),
        "classification": r.choice([2, 6], n).astype(np.uint8),
        "boundary": np.zeros(n, bool),
    }
    first = scene.draw_scene(echoes, (0.0, 0.0, 10.0), CLASSES)
    assert first == scene.draw_scene(echoes, (0.0, 0.0, 10.0), CLASSES)
    assert Image.open(io.BytesIO(first)).size[0] > 1000
    none = {name: values[:0] for name, values in echoes.items()}
    assert scene.draw_scene(none, (0.0, 0.0, 10.0), CLASSES)[:4] == b"\x89PNG"
    assert scene.draw_fscores([("zc", 0.5), ("width", 0.1)], {"zc"})[:4] == b"\x89PNG"


def test_without_a_ground_class_the_filter_and_heights_are_not_comparable() -> None:
    facts = {"steps": {}, "differences": {}, "classes": CLASSES[1:]}
    for name in ("ground_filter", "heights"):
        assert shi_claims.CLAIMS[name](facts)[1] == "not comparable"


def test_the_papers_are_shipped() -> None:
    for name in ("fan2013", "shi2019", "xiong2018"):
        template = Path(plots.__file__).with_name(f"{name}.html.j2")
        assert template.is_file()
        assert paper(name)["doi"].startswith("10.")
