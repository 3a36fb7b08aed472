"""Echoes that stand in the sources twice are counted, told and refused, whatever the tiles."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import laspy
import numpy as np
import pytest
from commandline import fwclass
from lasmaker import write_las
from smallsurvey import small_survey

from fwclass.report.repeated import repeated_facts
from fwclass.schema import Table
from fwclass.tile.stage import count_times, repeats, twice_measured

CUT, RIM = 500_040.0, 2.0


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    """The small survey as two files with a common rim, the second in reverse order."""
    path = small_survey(tmp_path)
    whole = laspy.read(tmp_path / "a.las")
    x = np.asarray(whole.x)
    for name, mask in (("west", x < CUT + RIM), ("east", x > CUT - RIM)):
        part = laspy.LasData(whole.header)
        part.points = whole.points[np.flatnonzero(mask)[:: 1 if name == "west" else -1]]
        part.write(tmp_path / f"{name}.las")
    path.write_text(path.read_text().replace("[a.las]", "[west.las, east.las]"))
    return path


@pytest.mark.parametrize(
    "words", [(), pytest.param(("--workflow", "ground"), marks=pytest.mark.slow), ("--workflow", "quality")]
)
def test_a_common_rim_is_told_and_refused(survey: Path, words: tuple[str, ...]) -> None:
    x = np.asarray(laspy.read(survey.parent / "a.las").x)
    rim = int(((x > CUT - RIM) & (x < CUT + RIM)).sum())
    facts = []
    for size in (25, 60):
        root = survey.parent / f"r{size}"
        line = ("run", survey, "--out", root, "--workers", 0, "--set", f"tile.size={size}", *words)
        ended = fwclass(*line)
        assert ended.returncode == 4 and "the sources have too many echoes twice" in ended.stderr, ended.stderr
        assert f"{rim:,} echoes, {100 * rim / (len(x) + rim):.1f} %, have place and time of another" in ended.stderr
        facts.append(json.loads((root / "report.json").read_text())["repeated"])
        assert (root / "report.html").exists() and "common rim" in (root / "report.html").read_text()
    assert facts[0] == facts[1] and facts[0]["echoes"] == rim
    ((one, other, count),) = facts[0]["files"]
    assert {one, other} == {"west.las", "east.las"} and count == rim
    assert fwclass(*line, "--accept-implausible").returncode == 0


def test_advice_goes_by_where_they_lie(survey: Path) -> None:
    whole = laspy.read(survey.parent / "a.las")
    twice = laspy.LasData(whole.header)
    twice.points = whole.points[np.concatenate([np.arange(len(whole.x)), np.arange(len(whole.x))])]
    twice.write(survey.parent / "west.las")
    survey.write_text(survey.read_text().replace("[west.las, east.las]", "[west.las]"))
    ended = fwclass("run", survey, "--out", survey.parent / "r", "--workers", 0, "--workflow", "quality")
    assert ended.returncode == 4 and "west.las itself" in ended.stderr, ended.stderr
    assert "points that are there twice" in ended.stderr and "take every file once" not in ended.stderr


def test_a_sound_survey_has_none(tmp_path: Path) -> None:
    assert fwclass("run", small_survey(tmp_path), "--out", tmp_path / "r", "--workers", 0).returncode == 0
    assert json.loads((tmp_path / "r" / "report.json").read_text())["repeated"] is None


def table(rows: list[tuple[float, float, float, float, int]]) -> Table:
    x, y, z, time, strip = zip(*rows, strict=True)
    return Table(
        {"x": np.array(x), "y": np.array(y), "z": np.array(z)}
        | {"gps_time": np.array(time), "strip": np.array(strip, np.uint16)}
    )


def test_repetitions_by_hand() -> None:
    nan = np.nan
    rows = [(1.0, 2, 3, 7, 5), (1.0, 2, 3, 7, 2), (1.0, 2, 3, 8, 2), (1.0, 2, 3, nan, 2), (1.0, 2, 3, nan, 2)]
    rows += [(1.0, 2, 3, 7, 9), (2.0, 1, 3, 7, 9), (1.001, 2, 3, 7, 2), (-1.0, 2, 3, 7, 5)]
    assert repeats(table(rows)) == [[2, 2, 1], [2, 5, 1], [2, 9, 1]]
    assert repeats(table(rows[:1])) == [] == repeats(table(rows[6:]))


def test_repetitions_in_any_order_and_number() -> None:
    rng = np.random.default_rng(3)
    rows = [(*rng.integers(0, 4, 4).astype(float), int(k)) for k in rng.integers(0, 3, 2000)]
    counted = repeats(table(rows))
    assert counted == repeats(table([rows[k] for k in rng.permutation(2000)]))
    assert sum(n for _, _, n in counted) == 2000 - len({r[:4] for r in rows})


def test_echoes_of_the_same_samples_are_one_measured_twice() -> None:
    """Copies of a packet are placed each by its own return, some millimetres apart."""
    nan = np.nan
    rows = [(1.0, 2, 3, 7, 5), (1.004, 2, 3, 7, 5), (2.0, 2, 3, 7, 5), (3.0, 2, 3, 8, 5), (4.0, 2, 3, 7, 5)]
    fit = {"amplitude": [30.0, 30.0, 20.0, 30.0, 30.0], "width": [4.0] * 5, "misfit": [1.1, 1.1, 1.1, 1.1, nan]}
    fitted = table(rows).with_columns({n: np.array(v, np.float32) for n, v in fit.items()})
    assert repeats(fitted) == [[5, 5, 1]] and repeats(table(rows)) == []
    apart = fitted.with_columns({"x": np.array([1.0, 30.0, 2.0, 3.0, 4.0])})  # another pulse, of times in whole seconds
    assert repeats(apart) == []
    twice = table([rows[0], rows[0]]).with_columns({n: np.array(v[:2], np.float32) for n, v in fit.items()})
    assert repeats(twice) == [[5, 5, 1]]
    assert repeats(fitted.with_columns({"gps_time": np.full(5, nan)})) == []


DAYS = 3 * 86_400 + 5_000.0
"""s of the week."""


def flown_twice(place: Path, change: Any = lambda part: None, rows: slice = slice(None)) -> Path:
    """The small survey as a file with times, and the `rows` of it (by x) that were `change`d in another format."""
    path = small_survey(place)
    whole = laspy.read(place / "a.las")
    whole.gps_time = 3e8 // 604_800 * 604_800 + DAYS + 1e-5 * np.arange(len(whole.x))
    whole.write(place / "a.las")
    other = laspy.convert(whole, point_format_id=7)
    other.points = other.points[np.argsort(np.asarray(whole.x))[rows]]
    change(other)
    other.write(place / "again.las")
    path.write_text(path.read_text().replace("[a.las]", "[a.las, again.las]"))
    return path


def lift(part: Any) -> None:
    part.z = np.asarray(part.z) + 0.02


def of_the_week(part: Any) -> None:
    part.gps_time = (np.asarray(part.gps_time) + 1e9) % 604_800


def standard(part: Any) -> None:
    part.x = np.asarray(part.x) + 0.03
    part.gps_time = np.asarray(part.gps_time) + 1e9


def measure(path: Path, *words: object) -> tuple[Any, Any]:
    """How the quality workflow ends, and what its report says of echoes that are there twice."""
    root = path.parent / "r"
    ended = fwclass("run", path, "--out", root, "--workflow", "quality", "--workers", 0, *words)
    return ended, json.loads((root / "report.json").read_text())


@pytest.mark.parametrize(
    ("change", "higher"), [(lift, 0.02), (of_the_week, 0.0), pytest.param(standard, 0.0, marks=pytest.mark.slow)]
)
def test_a_file_that_is_there_once_more_moved_or_by_another_clock_ends_with_4(
    tmp_path: Path, change: Any, higher: float
) -> None:
    path = flown_twice(tmp_path, change)
    facts = []
    for size in (25, 60):
        ended, report = measure(path, "--set", f"tile.size={size}")
        assert ended.returncode == 4 and "the sources have a file twice" in ended.stderr, ended.stderr
        (told,) = (line for line in report["remarks"] if "GPS time and number" in line)
        assert "a.las and again.las" in told and f"{higher:+.3f} m on average" in told
        facts.append(report["repeated"])
    assert facts[0] == facts[1]
    (pair,) = facts[0]["pairs"]
    assert pair["of_smaller"] > 0.8 and pair["moved"] == pair["echoes"] and abs(pair["higher"] - higher) < 1e-6
    assert measure(path, "--accept-implausible")[0].returncode == 0


def test_files_with_a_rim_that_was_lifted_say_how_much_they_share(tmp_path: Path) -> None:
    ended, report = measure(flown_twice(tmp_path, lift, slice(0, 1500)))  # all of it lies in the other: a small file
    assert ended.returncode == 4 and "have a file twice" in ended.stderr
    path = flown_twice(tmp_path, lift)
    for name, west in (("a.las", False), ("again.las", True)):
        part = laspy.read(tmp_path / name)
        x = np.asarray(part.x)
        part.points = part.points[x < CUT + RIM if west else x > CUT - RIM]
        part.write(tmp_path / name)
    ended, report = measure(path)
    assert ended.returncode == 4 and "too many echoes twice" in ended.stderr, ended.stderr
    (pair,) = report["repeated"]["pairs"]
    assert 0.07 < pair["of_smaller"] < 0.1 and f"{100 * pair['of_smaller']:.1f} % of the smaller one" in ended.stderr
    assert measure(path, "--set", "plausibility.max_repeated=0.1")[0].returncode == 0


def test_lines_over_one_place_are_not_one_flight(tmp_path: Path) -> None:
    def another_line(part: Any) -> None:
        part.gps_time = np.asarray(part.gps_time)[::-1] + 180.0

    ended, report = measure(flown_twice(tmp_path, another_line), "--set", "plausibility.max_repeated=0")
    assert ended.returncode == 0 and report["repeated"] is None, ended.stderr


@pytest.mark.parametrize("step", [1.0, 0.5, 1e9])
def test_coarse_times_tell_nothing(tmp_path: Path, step: float) -> None:
    path = flown_twice(tmp_path)
    for name, shift in (("a.las", 0.0), ("again.las", 0.04)):
        part = laspy.read(tmp_path / name)
        part.x = np.asarray(part.x)[:: 1 if shift == 0 else -1] + shift
        part.gps_time = np.floor(np.asarray(part.gps_time) / step) * step + 1.0
        part.write(tmp_path / name)
    ended, report = measure(path)
    assert ended.returncode == 0 and (report["repeated"] or {"share": 0.0})["share"] < 0.01, report["repeated"]


@pytest.mark.parametrize("edge", [1e9, 40.0, 2.0, 0.5])
def test_whether_times_are_coarse_is_asked_of_the_whole_strip(edge: float) -> None:
    """A strip's seconds, each of ten pulses: a tile that holds few of them must not take these for its pulses' own."""
    along = np.arange(0.25, 200.0, 0.5)
    lines = [[(x + off, 0.25, z, 7.0 + x // 5.0, k) for x in along] for k, off, z in ((0, 0.0, 1.0), (1, 0.02, 1.5))]
    strips = [table(line).with_columns({"echo_number": np.ones(len(line), np.uint8)}) for line in lines]
    whole = Table.concat(strips)
    tiles = [whole.take(np.flatnonzero(whole["x"] // edge == k)) for k in np.unique(whole["x"] // edge)]
    metas = [{"rows": t.rows, "repeated": repeats(t), "moved": twice_measured(t)} for t in tiles]
    assert sum(n for meta in metas for *_, n, _ in meta["moved"]) == len(along)
    names = [SimpleNamespace(number=k, path=Path(f"{k}.las")) for k in (0, 1)]
    counted = [[len(along), len(along)] if fine else count_times(s) for fine in (False, True) for s in strips]
    for k, expected in ((0, None), (2, len(along))):
        read = [
            SimpleNamespace(part=f"{i:05d}-00000", meta={"echoes": len(along), "times": counted[k + i]}) for i in (0, 1)
        ]
        facts = repeated_facts(metas, cast(Any, names), cast(Any, read))
        assert (facts and facts["echoes"]) == expected


def test_times_of_first_echoes_by_hand() -> None:
    times = [7.0, 7.0, 8.0, np.nan, 0.0, 9.0]
    numbered = table([(1.0, 2, 3, t, 5) for t in times])
    numbered = numbered.with_columns({"echo_number": np.array([1, 1, 1, 1, 1, 2], np.uint8)})
    assert count_times(numbered) == [3, 2] and count_times(numbered.take(np.array([3, 4, 5]))) == [0, 0]


def test_moved_echoes_by_hand() -> None:
    rows = [(1.0, 2, 3, 7.25, 5), (1.02, 2, 3.5, 7.25, 2), (1.0, 2, 3, 8.25, 2), (1.0, 2, 3, np.nan, 2)]
    rows += [(9.0, 2, 3, 7.25, 9), (1.0, 2, 4, 7.25, 6), (1.0, 2, 4, 0.0, 6), (1.0, 2, 5, 0.0, 7)]
    numbered = table(rows).with_columns({"echo_number": np.ones(len(rows), np.uint8)})
    assert twice_measured(numbered) == [[2, 5, 1, -500], [2, 6, 1, 500]]
    assert twice_measured(numbered.take(np.arange(len(rows))[::-1])) == [[2, 5, 1, -500], [2, 6, 1, 500]]
    assert twice_measured(numbered.take(np.array([0, 2, 3]))) == [] == twice_measured(numbered.take(np.array([0])))
    same = table([(1.0, 2, 3, 7.0, 1), (1.0, 2, 3, 7.0, 2)]).with_columns({"echo_number": np.ones(2, np.uint8)})
    assert twice_measured(same) == []  # `repeats` counts them
    second = same.with_columns({"echo_number": np.array([1, 2], np.uint8), "z": np.array([3.0, 4.0])})
    assert twice_measured(second) == []


@pytest.mark.parametrize(
    "words",
    [("ground",), ("normalize", "--method", "smrf"), ("features", "--features", "echo_ratio_r100"), ("decompose",)],
)
def test_points_that_one_file_has_twice_end_commands_on_it(survey: Path, words: tuple[str, ...]) -> None:
    whole = laspy.read(survey.parent / "a.las")
    rows = np.arange(len(whole.x))
    for name, taken, share in (("twice", np.r_[rows, rows], "50.0 %"), ("some", np.r_[rows, rows[:3]], "")):
        points = laspy.LasData(whole.header)
        points.points = whole.points[taken]
        points.write(survey.parent / f"{name}.las")
        out = survey.parent / ("o.parquet" if words[0] == "features" else "o.laz")
        line = (words[0], survey.parent / f"{name}.las", out, "--overwrite", *words[1:])
        ended = fwclass(*line)
        assert ended.returncode == (4 if share else 0), ended.stderr
        assert ("the sources have too many echoes twice" in ended.stderr) == bool(share) and share in ended.stderr
    if words[0] == "ground":
        text = survey.parent / "twice.txt"
        np.savetxt(text, np.tile(np.c_[whole.x, whole.y, whole.z], (2, 1)), fmt="%.3f")
        ended = fwclass("ground", text, survey.parent / "o.txt")
        assert ended.returncode == 0 and "have the place of another" in ended.stderr


def test_first_returns_alone_are_told_where_ground_is_made_of_last_ones(tmp_path: Path) -> None:
    xyz = np.random.default_rng(0).uniform(0, 60, (6000, 3)) * [1, 1, 0.02]
    for number, told in ((np.ones(6000, int), True), (np.tile([1, 2], 3000), False)):
        of = np.where(np.arange(6000) % 10 == 0, number, 2)
        write_las(tmp_path / "a.las", xyz, point_format=6, return_number=number, number_of_returns=of)
        for words in (("ground",), ("normalize", "--method", "smrf")):
            ended = fwclass(words[0], tmp_path / "a.las", tmp_path / "o.laz", "--overwrite", *words[1:])
            assert ended.returncode in (0, 4), ended.stderr
            assert ("lack their last one" in ended.stderr) == told, ended.stderr
