"""Corrections of labels: what a run does with them and makes anew for them; none is trained on and tested."""

from __future__ import annotations

import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from smallsurvey import small_survey

from fwclass.cli import cli
from fwclass.formats.echo_labels import EchoLabels, echo_labels_bytes
from fwclass.operate.clean import clean
from fwclass.run.inputs import PartInputs
from fwclass.schema import canonical_key
from fwclass.store.atomic import read_json
from fwclass.store.corrections import add_corrections
from fwclass.store.run_store import Store
from fwclass.walk import steps

GAP = 1.0
PLACE = ("strip", "pulse", "echo_number", "x", "y", "z")
SPOT = (500_060, 5_400_010, 500_064, 5_400_014)
"""Within one tile of 25 m, far from the training area and from the tile's borders."""


def run(survey, root, *settings):
    words = [w for s in settings for w in ("--set", s)]
    made = CliRunner().invoke(cli, ["run", str(survey), "--out", str(root), "--workers", "0", *words])
    if made.exception is not None and not isinstance(made.exception, SystemExit):
        raise made.exception
    assert made.exit_code == 0, made.output
    return read_json(root / "report.json")


def computed(report):
    return {s["name"]: s["computed"] for s in report["stages"] if s["computed"]}


def echoes(root):
    """Every echo of a run with its label and class."""
    store = Store(root, read_only=True)
    columns = {**dict.fromkeys(PLACE, "tile"), "reference": "label", "classification": "classify"}
    tables = [PartInputs(store).rows(part, columns) for stage, part in sorted(store.parts()) if stage == "tile"]
    return {n: np.concatenate([t[n] for t in tables]) for n in columns} | {
        "key": np.concatenate([canonical_key(t) for t in tables])
    }


def trained(root):
    return PartInputs(Store(root, read_only=True)).arrays("training", "all", "sample", ("key", "y"))[0]


def correct(root, rows, code, made=None, **moved):
    made = echoes(root) if made is None else made
    columns = {n: made[n][rows] + moved.get(n, 0) for n in PLACE}
    codes = np.broadcast_to(code, int(rows.sum()))
    return add_corrections(root, lambda _: EchoLabels.of(columns, codes, 1, "operator"))


def inside(made, box=SPOT):
    return (made["x"] >= box[0]) & (made["y"] >= box[1]) & (made["x"] < box[2]) & (made["y"] < box[3])


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """A run without corrections: (survey, root, report, echoes)."""
    place = tmp_path_factory.mktemp("corrected")
    survey = small_survey(place, tile=25)
    report = run(survey, place / "run")
    return survey, place / "run", report, echoes(place / "run")


@pytest.fixture(scope="module")
def second(first):
    """The same after the echoes of a spot were corrected to the other class."""
    survey, root, _, before = first
    rows = inside(before)
    correct(root, rows, np.where(before["reference"][rows] == 2, 5, 2), before)
    told = CliRunner().invoke(cli, ["status", str(root)])
    assert told.exit_code == 3 and "are taken where nothing of theirs changed" in told.output, told.output
    assert "does not name" not in told.output, "every part was listed as if none were wanted"
    return survey, root, run(survey, root), echoes(root), before, rows


def test_only_the_tiles_of_corrections_are_labelled_anew(first, second):
    report = second[2]
    made = computed(report)
    assert made["corrections"] == 1 and made["label"] == 1 and made["sample"] == 1
    assert made["label-counts"] <= 2  # the tile itself, and one that lies within the gap
    for stage in ("split", "tile", "ground", "features", "height", "decompose"):
        assert stage not in made
    assert first[2]["sampling"]["corrections"] is None
    wanted = {"standing": int(second[5].sum()), "taken_back": 0, "applied": int(second[5].sum())}
    assert report["sampling"]["corrections"] == wanted and wanted["standing"] > 10


def test_corrected_echoes_have_the_corrected_class_and_all_others_their_own(second):
    _, _, _, after, before, rows = second
    expected = np.where(rows, np.where(before["reference"] == 2, 5, 2), before["reference"])
    np.testing.assert_array_equal(after["key"], before["key"])
    np.testing.assert_array_equal(after["reference"], expected)


def test_a_corrected_echo_trains_and_is_not_tested(second):
    """All of them train, though the sample is of other places; none is counted as tested, nor is what lies near."""
    _, root, report, after, _, rows = second
    assert np.isin(after["key"][rows], trained(root)["key"]).all()
    train = (after["x"] < 500_030 + GAP) & (after["x"] >= 500_000 - GAP)
    spot = np.stack([after["x"][rows], after["y"][rows]], axis=1)
    far = np.maximum(np.abs(after["x"][:, None] - spot[:, 0]), np.abs(after["y"][:, None] - spot[:, 1])).min(axis=1)
    tested = ~train & (np.rint(1000 * far) > 1000 * GAP) & np.isin(after["reference"], [2, 5])
    matrix = np.array(report["accuracy"]["confusion"])
    assert matrix.sum() == tested.sum() == sum(c["test"] for c in report["sampling"]["classes"])
    right = after["classification"][tested] == after["reference"][tested]
    assert np.trace(matrix) == right.sum()
    both = np.isin(after["key"][tested], trained(root)["key"])
    assert not both.any()
    assert any("people correct the worst places" in r for r in report["accuracy"]["remarks"])


def test_with_the_same_corrections_nothing_is_made_anew(second):
    again = CliRunner().invoke(cli, ["status", str(second[1])])
    assert again.exit_code == 0, again.output


@pytest.mark.slow
def test_labels_and_sample_do_not_depend_on_the_tiles(second, tmp_path):
    """A border of tiles of 12.5 m goes through the corrected spot."""
    survey, root, report, after, _, _ = second
    (tmp_path / "labels").mkdir()
    (tmp_path / "labels" / "corrections.parquet").write_bytes((root / "labels" / "corrections.parquet").read_bytes())
    other = run(survey, tmp_path, "tile.size=12.4")
    made = echoes(tmp_path)
    a, b = np.argsort(after["key"]), np.argsort(made["key"])
    for name in ("key", "reference", "classification"):
        np.testing.assert_array_equal(after[name][a], made[name][b])
    np.testing.assert_array_equal(trained(root)["key"], trained(tmp_path)["key"])
    assert other["accuracy"]["confusion"] == report["accuracy"]["confusion"]
    assert other["sampling"]["corrections"] == report["sampling"]["corrections"]


def test_what_is_taken_back_is_as_if_it_had_never_been(first, tmp_path):
    survey, _, report, before = first
    rows = inside(before)
    correct(tmp_path, rows, 5, before)
    correct(tmp_path, rows, -1, before)
    made = run(survey, tmp_path)
    np.testing.assert_array_equal(echoes(tmp_path)["reference"], before["reference"])
    assert made["accuracy"]["confusion"] == report["accuracy"]["confusion"]
    assert made["sampling"]["corrections"] == {"standing": 0, "taken_back": int(rows.sum()), "applied": 0}


def test_a_correction_whose_echo_moved_is_told_and_not_applied(first, tmp_path):
    survey, _, _, before = first
    rows = inside(before)
    correct(tmp_path, rows, 5, before, z=0.2)
    other = ~rows & (before["x"] > 500_070)
    correct(tmp_path, other, 5, before, pulse=10_000)
    report = run(survey, tmp_path)
    lost = int(rows.sum() + other.sum())
    assert report["sampling"]["corrections"] == {"standing": lost, "taken_back": 0, "applied": 0}
    assert any(f"{lost:,} of {lost:,} corrections label nothing" in r for r in report["sampling"]["remarks"])
    np.testing.assert_array_equal(echoes(tmp_path)["reference"], before["reference"])


def test_corrections_that_leave_no_test_are_told_with_what_to_do(first, tmp_path):
    survey, _, _, before = first
    for code in (2, 5):
        correct(tmp_path, before["reference"] == code, code, before)
    report = run(survey, tmp_path)
    count = report["sampling"]["corrections"]["applied"]
    assert report["accuracy"] is None is report["distribution"], "no table of blanks"
    assert count == np.isin(before["reference"], (2, 5)).sum() > 0
    told = [r for r in report["sampling"]["remarks"] if f"{count:,} echoes were corrected or confirmed" in r]
    assert len(told) == 1 and "List boxes as areas.test" in told[0]


def test_a_listed_test_area_stays_one(first, tmp_path):
    """What is corrected there is tested by its new label, and does not train."""
    survey, _, _, before = first
    rows = inside(before)
    correct(tmp_path, rows, 5, before)
    report = run(survey, tmp_path, "areas.test=[[500050, 5400000, 500080, 5400040]]")
    assert not np.isin(before["key"][rows], trained(tmp_path)["key"]).any()
    tested = inside(before, (500_050, 5_400_000, 500_080, 5_400_040)) & np.isin(before["reference"], [2, 5])
    assert np.array(report["accuracy"]["confusion"]).sum() == tested.sum()


def test_labels_by_echo_are_a_reference(first, tmp_path):
    """The delivered table of another run serves as one, in several files."""
    survey, root, _, _before = first
    settings = (
        f"survey.reference={{kind: echoes, files: ['{root / 'parquet'}/*.parquet'], field: classification}}",
        "survey.reference.corrections=false",
    )
    report = run(survey, tmp_path, *settings)
    assert not any("by echo label nothing" in r for r in report["sampling"]["remarks"])
    made = echoes(tmp_path)
    given = {}
    for path in (root / "parquet").glob("*.parquet"):
        table = pq.read_table(path, columns=[*PLACE[:3], "classification"])
        given |= dict(
            zip(
                zip(*(table[n].to_pylist() for n in PLACE[:3]), strict=True),
                table["classification"].to_pylist(),
                strict=True,
            )
        )
    keys = zip(made["strip"].tolist(), made["pulse"].tolist(), made["echo_number"].tolist(), strict=True)
    assert made["reference"].tolist() == [given[k] for k in keys]


def test_labels_by_echo_whose_echo_is_another_now_are_told(first, tmp_path):
    survey, root, _, _before = first
    table = pa.concat_tables(
        [
            pq.read_table(path, columns=[*PLACE[:3], "x", "y", "z", "classification"])
            for path in (root / "parquet").glob("*.parquet")
        ]
    )
    moved = np.arange(table.num_rows) % 5 == 0
    height = table["z"].to_numpy() + np.where(moved, 1.0, 0.0)
    pq.write_table(table.set_column(5, "z", pa.array(height)), tmp_path / "labels.parquet")
    told = run(
        survey,
        tmp_path / "run",
        f"survey.reference={{kind: echoes, files: ['{tmp_path}/labels.parquet'], field: classification}}",
        "survey.reference.corrections=false",
    )["sampling"]["remarks"]
    assert any(f"{moved.sum():,} of {table.num_rows:,} labels by echo label nothing" in line for line in told)


@pytest.mark.parametrize(
    "setting, words",
    [
        ("survey.reference.corrections=no-such.parquet", "no file matches"),
        ("survey.reference.corrections=a.las", "labels by echo cannot be read"),
        ("survey.reference={kind: echoes}", "kind echoes needs `files`"),
        ("survey.reference={kind: none, corrections: a.parquet}", "kind none has none"),
        ("survey.reference={kind: echoes, files: [a.las]}", "labels by echo cannot be read"),
    ],
)
def test_what_cannot_be_labels_is_told_before_anything_is_computed(first, tmp_path, setting, words):
    made = CliRunner().invoke(
        cli, ["run", str(first[0]), "--out", str(tmp_path / "r"), "--workers", "0", "--set", setting]
    )
    assert made.exception is not None and words in str(made.exception)
    assert not (tmp_path / "r").exists()


def test_a_code_of_no_class_is_told_with_its_count(first, tmp_path):
    survey, _, _, before = first
    correct(tmp_path, inside(before), 17, before)
    made = CliRunner().invoke(cli, ["run", str(survey), "--out", str(tmp_path), "--workers", "0"])
    assert made.exception.exit_code == 2
    assert f"17 ({int(inside(before).sum())} rows)" in str(made.exception)


def test_corrections_that_are_added_while_a_run_begins_are_the_next_run_s(tmp_path, monkeypatch):
    """The run goes by those that it began with, and ends as one without the others; it ended with exit code 1."""
    survey, root = small_survey(tmp_path), tmp_path / "run"
    run(survey, root)
    made = echoes(root)
    rows = inside(made)
    correct(root, rows, 2, made)
    taken = steps.gather

    def taken_and_more_are_added(*words):
        survey = taken(*words)
        correct(root, rows, 5, made)
        return survey

    monkeypatch.setattr(steps, "gather", taken_and_more_are_added)
    assert run(survey, root)["sampling"]["corrections"]["standing"] == rows.sum()
    assert (echoes(root)["reference"][rows] == 2).all()
    assert not (root / "store" / "staging").exists()
    monkeypatch.setattr(steps, "gather", taken)
    assert CliRunner().invoke(cli, ["status", str(root)]).exit_code == 3
    run(survey, root)
    assert (echoes(root)["reference"][rows] == 5).all()
    assert CliRunner().invoke(cli, ["status", str(root)]).exit_code == 0


@pytest.mark.parametrize("own", [False, True])
def test_a_cleaned_run_stands_until_its_corrections_are_others(second, tmp_path, own):
    """Of every cleaned run that had corrections `status` said that they had changed or come since."""
    survey, named, root = second[0], tmp_path / "mine.parquet", tmp_path / "run"
    shutil.copytree(second[1], root, symlinks=True)
    if own:
        (root / "labels" / "corrections.parquet").rename(named)
        run(survey, root, f"survey.reference.corrections={named}")
    clean(root, "delivery", print)
    told = CliRunner().invoke(cli, ["status", str(root)])
    assert told.exit_code == 0 and "sources" not in told.output, told.output
    if own:
        named.write_bytes(echo_labels_bytes(EchoLabels.of({n: second[4][n][:1] for n in PLACE}, [2], 1, "another")))
    else:
        correct(root, inside(second[4]), 5, second[4])
    told = CliRunner().invoke(cli, ["status", str(root)])
    words = f"sources changed or came since then: {named.name if own else 'corrections.parquet'}"
    assert told.exit_code == 3 and words in told.output, told.output
