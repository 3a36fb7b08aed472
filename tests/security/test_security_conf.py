"""A stranger's configuration is plain data, and no number in it can hang the program or fill the memory."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from commandline import fwclass

from fwclass import conf
from fwclass.cli import main  # noqa: F401 - what a command would have loaded is not counted
from fwclass.cli.base import MOST_WORKERS
from fwclass.conf.files import _mapping, merge, plain, read
from fwclass.conf.sections import RunSection
from fwclass.conf.sets import feature_set
from fwclass.errors import ConfigError
from fwclass.single_file.ground.params import ground_params

ABSURD = (1e308, 10**18, -1e308)

HARMLESS = {
    "schedule",
    "areas",
    "survey.trajectory",
    "radiometry.platform_altitude",
    "radiometry.calibration",
    "radiometry.max_time_gap",
    "radiometry.overlap.least_echoes",
    "radiometry.overlap.max_spread",
    "radiometry.overlap.least_cells",
    "simulate.origin_x",
    "simulate.origin_y",
    "simulate.base_height",
    "simulate.scene",
    "simulate.flight",
    "simulate.sensor",
    "plan.wave_bytes",
    "plan.base_mib",
    "plan.compile_seconds",
    "plan.stages",
    "plan.of_returns",
    "plan.of_ground",
    "assess.min_kappa",
    "pulse.bright",
    "pulse.worth",
}
"""A large number here is a threshold that nothing reaches, a place, or the sum of a plan: it costs nothing."""

THRESHOLDS = {
    "steepest",
    "low_gap",
    "high_gap",
    "low_shape",
    "high_shape",
    "sigma",
    "sigma_least",
    "surface_gap",
    "slope",
    "tolerance",
    "initial_distance",
    "max_distance",
    "scalar",
    "threshold",
    "low_slope",
    "low_level",
    "restore_tolerance",
    "distance",
    "first_distance",
    "angle_of_slope",
    "spacing",
    "offset",
    "class_threshold",
    "time_step",
    "detection",
    "split_gain",
    "separation",
    "noise_floor",
    "poor_misfit",
    "vendor_tolerance",
    "register_within",
    "tail_reach",
    "c",
    "l2",
    "thin",
    "features_per_split",
    "seed",
}
"""Numbers by which something is judged; they say nothing of how much is made."""


def numbers(node: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """Every number of a configuration by its dotted name."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield from numbers(value, f"{name}.{key}" if name else str(key))
    elif isinstance(node, int | float) and not isinstance(node, bool):
        yield name, float(node)


BASE = read(conf.conf_directory() / "base.yaml")


def bound(name: str) -> bool:
    """A limit is asked of this number."""
    known = any(name == h or name.startswith(h + ".") for h in HARMLESS)
    return (
        not known and name.split(".")[-1] not in THRESHOLDS and not name.startswith(("ground_search", "ground_auto.c"))
    )


def refused(name: str, value: float) -> bool:
    """The section does not take `value` for the number `name`."""
    section = name.split(".")[0]
    change: Any = value
    for key in reversed(name.split(".")[1:]):
        change = {key: change}
    try:
        conf.checked(section, merge(BASE[section], change), "here")
    except ConfigError:
        return True
    return False


@pytest.mark.parametrize(
    "words",
    [
        ("seams", "RUN", "--share", "nan"),  # ended with 0, and had looked at what nobody knows
        ("seams", "RUN", "--length", "inf"),
        ("street", "annotate", "r.parquet", "a.csv", "--slice", "nan"),
        ("suggest", "RUN", "OUT", "--size", "nan"),
        ("decompose", "a.las", "b.laz", "--undulation", "nan"),  # the trajectory was blamed
    ],
)
def test_what_is_no_number_is_none_on_the_command_line(words: tuple[str, ...], tmp_path: Path) -> None:
    ended = fwclass(*words, cwd=tmp_path)
    assert ended.returncode == 2 and "is no finite number" in ended.stderr, ended.stderr


def test_workers_of_the_command_line_have_the_limit_of_the_configuration(tmp_path: Path) -> None:
    """100 million took 5 GB and a traceback."""
    ended = fwclass("run", tmp_path / "s.yaml", "--workers", 10**8)
    assert ended.returncode == 2 and f"0<=x<={MOST_WORKERS}" in ended.stderr
    (limit,) = (m.le for m in RunSection.model_fields["workers"].metadata if hasattr(m, "le"))
    assert limit == MOST_WORKERS


def test_every_number_that_decides_how_much_is_made_has_a_limit() -> None:
    """Of `conf/base.yaml`, all but thresholds and places: 1e308, 10^18 and -1e308 are refused by name."""
    asked = [name for name, _ in numbers(BASE) if bound(name)]
    assert len(asked) > 80
    free = [f"{name}={value:g}" for name in asked for value in ABSURD if not refused(name, value)]
    assert free == []


@pytest.mark.parametrize(
    "setting",
    [
        "simulate.scene.tree_share=1e12",
        "simulate.scene.terrain_step=1e-9",
        "simulate.sensor.rings=[1, 1000000000]",
        "simulate.flight.speed=1e-300",
        "simulate.flight.trajectory_rate=1e12",
        "simulate.sensor.long_segment=1000000",
        "simulate.chunk=1000000000000",
        "ground.smrf.cell=1e-9",
        "ground.smrf.cell=0.02",
        "ground.block=1e-9",
        "ground.csf.cloth_resolution=1e-6",
        "terrain.cell=0.01",
        "terrain.thin=1e-9",
        "tile.size=1e-9",
        "tile.size=1e308",
        "publish.class_cell=0.01",
        "run.workers=1000000000000",
        "read.chunk_pulses=1000000000000",
        "train.samples_per_class=1000000000000",
        "train.trees=1000000000000",
        "select.folds=1000000000",
        "compare.rbf_svm.max_rows=1000000000",
        "features.cell_x=-12",
        "features.cell_x=1e-9",
        "plan.sizes=[1e-9]",
        "assess.block=1e-9",
        "thin.cell=1e-9",
        "survey.name=../../x",
        "survey.name=/etc/x",
        "survey.name=..",
        'survey.name="a\\nb"',
        "survey.name=" + "a" * 300,
        "survey.sources=['" + "[" * 1_100 + "']",
        "survey.trajectory.files=['" + "[" * 1_100 + "']",
        'survey.classes=[{name: "a\\e[31m", code: 2, codes: [2]}, {name: b, code: 6, codes: [6]}]',
    ],
)
def test_what_would_never_end_or_fit_is_refused(setting: str) -> None:
    with pytest.raises(ConfigError) as fault:
        conf.load("demo", (setting,))
    assert len(str(fault.value)) < 3000


@pytest.mark.parametrize(
    "text",
    [
        "!!python/object/apply:os.system [touch /tmp/x]",
        "!!python/name:os.system",
        "!own {a: 1}",
        "!!timestamp x",
        "!!binary aGVsbG8=",
        "!!set {a, b}",
        "!!str a",
        "2001-99-99",
        "9" * 5000,
        "? [a]\n: b",
        "? {a: b}\n: c",
        "[" * 100_000,
        "{a: " * 20_000,
        "- " * 60_000,
        "&a [*a]",
        "\x00",
        "a: b: c",
        "{a: 1, a: 2}",
    ],
)
def test_what_is_no_plain_data_is_refused_in_words(text: str, tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(f"survey: {text}\n")
    for reader in (read, conf.load, lambda p: feature_set(str(p))):
        with pytest.raises(ConfigError) as fault:
            reader(path)
        assert str(path) in str(fault.value) and len(str(fault.value)) < 3000
    with pytest.raises(ConfigError):
        conf.load("demo", (f"survey.name={text}",))


def bomb(levels: int) -> str:
    """Nine aliases of nine aliases of …: a billion laughs."""
    rows = ["a0: &a0 [lol, lol, lol, lol, lol, lol, lol, lol, lol]"]
    rows += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, levels)]
    return "\n".join(rows)


@pytest.mark.parametrize(
    "text", [bomb(30), "a0: &a0 [x]\n" + "\n".join(f"a{k}: &a{k} [*a{k - 1}]" for k in range(1, 1000))]
)
def test_aliases_do_not_explode(text: str, tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text)
    tracemalloc.start()
    try:
        with pytest.raises(ConfigError, match=r"aliases|levels deep"):
            conf.load(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 200 * len(text) + (16 << 20)


def test_a_file_of_megabytes_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("# " + "a" * (1 << 20))
    with pytest.raises(ConfigError, match="this large"):
        read(path)


def test_aliases_that_a_person_writes_are_read() -> None:
    assert plain("a: &tin [1, 2]\nb: *tin") == {"a": [1, 2], "b": [1, 2]}


@pytest.mark.parametrize("number", ["0x" + 50_000 * "f", ":".join(20_000 * ["59"]), "0b" + 50_000 * "1", 50_000 * "7"])
def test_a_number_of_thousands_of_digits_is_refused_however_it_is_written(number, tmp_path):
    (tmp_path / "s.yaml").write_text(f"tile: {{size: {number}}}\n")
    with pytest.raises(ConfigError, match="cannot be read") as fault:
        conf.load(tmp_path / "s.yaml")
    assert "too long" in str(fault.value) and len(str(fault.value)) < 2000


SMALL = """survey:
  name: small
  sources: [a.las]
  reference: {kind: source}
  features: [zc]
  classes: [{name: a, code: 2, codes: [2]}, {name: b, code: 5, codes: [5]}]
areas: {train: [[0, 0, 1, 1]], gap: 0.5}
"""


def many(text: str, count: int) -> str:
    """A list of `count` entries, ``{}`` of which is their number."""
    return f"[{', '.join(text.format(k) for k in range(count))}]"


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("survey:", "".join(f"k{k}: 1\n" for k in range(28_000)) + "survey:"),
        ("[zc]", many("f{}", 30_000)),
        ("codes: [5]", f"codes: {many('2', 80_000)}"),
        ("classes: [", f"classes: {many('{{name: a{0}, code: 2, codes: [2]}}', 5_000)[:-1]}, "),
    ],
    ids=["sections", "features", "codes", "classes"],
)
def test_thousands_of_anything_are_refused_in_a_few_lines(before: str, after: str, tmp_path: Path) -> None:
    """Each was held against all others, and all were told in a message of 13 MB."""
    path = tmp_path / "a.yaml"
    path.write_text(SMALL.replace(before, after, 1))
    with pytest.raises(ConfigError, match=r"at most|faults") as fault:
        conf.load(path)
    assert len(str(fault.value)) < 20_000


@pytest.mark.parametrize("value", ["1:30", "1:30.5", "030", "true"])
def test_what_yaml_makes_another_number_of_is_refused(value: str) -> None:
    """By sixties 90, by eights 24; true is 1."""
    with pytest.raises(ConfigError, match=r"in sixties or in eights|neither true nor false"):
        conf.section("tile", (f"tile.size={value}",))


def test_keys_are_not_held_against_each_other() -> None:
    """50 s of the processor for a file of 220 KB."""
    compared = 0

    class Key(str):
        __hash__ = str.__hash__

        def __eq__(self, other: object) -> bool:
            nonlocal compared
            compared += 1
            return str.__eq__(self, other)

    node = SimpleNamespace(value=[(Key(f"k{n}"), n) for n in range(1000)], start_mark=None)
    assert len(_mapping(SimpleNamespace(construct_object=lambda one, deep: one), node)) == 1000
    assert compared < 5000


def test_a_feature_set_says_how_many_features_it_has_before_they_are_made(tmp_path: Path) -> None:
    path, names = tmp_path / "a.yaml", many("f{}", 4000)
    path.write_text(f"each: [{{bases: {names}, scales: {names}}}]\n")
    tracemalloc.start()
    try:
        with pytest.raises(ConfigError, match="too many features") as fault:
            feature_set(str(path))
        assert tracemalloc.get_traced_memory()[1] < 64 << 20 and "16,000,000" in str(fault.value)
    finally:
        tracemalloc.stop()


def test_a_feature_set_is_that_beside_its_survey_whatever_lies_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stranger's directory had the same name, and was asked first."""
    for name, feature in (("mine", "zc"), ("theirs", "density_c100")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "own.yaml").write_text(f"features: [{feature}]\n")
    path = tmp_path / "mine" / "s.yaml"
    path.write_text(SMALL.replace("[zc]", "own.yaml"))
    monkeypatch.chdir(tmp_path / "theirs")
    assert conf.load(path).features_asked == ("zc",)


@pytest.mark.parametrize(
    "name", ["../presets/ground", "ground.yaml", "/etc/passwd", "./mine", "", "..", "a\0b", "about"]
)
def test_a_preset_is_one_that_comes_with_fwclass(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No name of one leads to a file, and none beside the survey or here is looked for."""
    for place in ("mine", "presets/ground.yaml", "conf/presets/ground.yaml"):
        (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / place).write_text("mine: {method: slope}\n")
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "a.yaml"
    path.write_text(SMALL + f"ground: {{preset: {json.dumps(name)}}}\n")
    for ask in (lambda: conf.load(path), lambda: ground_params(None, name)):
        with pytest.raises(ConfigError, match="no such preset"):
            ask()


def test_profiles_that_no_memory_holds_are_refused_before_anything_runs(tmp_path: Path) -> None:
    """415 GiB were asked for in a part; half of what is there would have been taken."""
    path = tmp_path / "a.yaml"
    path.write_text(SMALL)
    fine = ("profile.write=true", "profile.cell=0.5", "profile.bin=0.5")
    assert conf.load(path, fine).profile.cell == 0.5
    with pytest.raises(ConfigError, match="too many numbers") as fault:
        conf.load(path, (*fine, "profile.bin=0.01"))
    assert "profile.cell, profile.bin" in str(fault.value)


def test_voxels_that_no_block_holds_are_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(SMALL)
    fine = ("voxels.write=true", "voxels.size=0.1")
    conf.load(path, fine)
    with pytest.raises(ConfigError, match="too many for a block already") as fault:
        conf.load(path, (*fine, "voxels.most=1000000"))
    assert "voxels.size" in str(fault.value) and "1,000,000" in str(fault.value)
    conf.load(path, ("voxels.size=0.1", "voxels.most=1000000"))
