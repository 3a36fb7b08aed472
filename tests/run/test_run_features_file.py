"""`fwclass features`: one file of any kind to GeoParquet, the lists, and what cannot be given."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import lasmaker
import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from fwclass import conf
from fwclass.cli import cli
from fwclass.conf.sets import feature_set, shipped_sets
from fwclass.errors import ConfigError, InputError
from fwclass.features.stage import features
from fwclass.grid import Tile
from fwclass.ground.methods.noise import noise
from fwclass.schema import Table
from fwclass.single_file.features.file import FeaturesJob, features_file
from fwclass.single_file.features.listing import describe
from fwclass.single_file.features.names import requested_features, sorted_settings
from fwclass.stage import Chunk

NAMES = ("height_above_ground", "echo_number", "zc", "planarity_r100", "height_std_k20", "count_g200", "egi_c100")


def cloud(rng, pulses=4000, side=30.0):
    of = rng.choice([1, 1, 1, 2, 3], pulses)
    pulse = np.repeat(np.arange(pulses), of)
    number = np.arange(len(pulse)) - np.repeat(np.cumsum(of) - of, of) + 1
    x, y = (rng.uniform(0, side, (2, pulses))[:, pulse]).round(3)
    low = number == of[pulse]
    z = np.where(low, 0.1 * x, 0.1 * x + 9 - 2 * number).round(3)
    z[~low & (pulse % 500 == 0)] += 60.0  # alone in the air
    return Table(
        {
            "strip": np.zeros(len(x)),
            "pulse": pulse,
            "echo_number": number,
            "number_of_echoes": of[pulse],
            "x": x + 500_000,
            "y": y + 5_400_000,
            "z": z + 100,
            "intensity": rng.integers(0, 60_000, len(x)),
            "source_class": np.where(low, 2, 5),
        }
    )


@pytest.fixture(scope="module")
def truth():
    return cloud(np.random.default_rng(3))


@pytest.fixture(scope="module")
def las(truth, tmp_path_factory):
    path = tmp_path_factory.mktemp("features") / "a.las"
    data = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    data.header.scales, data.header.offsets = [0.001] * 3, [500_000.0, 5_400_000.0, 0.0]
    data.x, data.y, data.z = truth["x"], truth["y"], truth["z"]
    data.return_number, data.number_of_returns = truth["echo_number"], truth["number_of_echoes"]
    data.intensity, data.classification = truth["intensity"], truth["source_class"]
    data.gps_time = truth["pulse"] * 1e-5
    data.write(path)
    return path


@pytest.fixture(scope="module")
def made(las):
    output = las.with_suffix(".parquet")
    return features_file(FeaturesJob(las, output, listed=",".join(NAMES))), pq.read_table(output)


def test_every_echo_with_its_place_class_and_features(made, truth):
    facts, table = made
    assert table.num_rows == facts["echoes"] == truth.rows
    own = [n for n in NAMES if n != "echo_number"]
    assert table.column_names[-len(own) - 2 :] == [*own, "geometry", "bbox"]
    assert table.column_names[:3] == ["strip", "pulse", "echo_number"]
    order = np.lexsort((table["echo_number"], table["pulse"]))
    for name in ("x", "y", "z", "echo_number", "number_of_echoes", "source_class"):
        np.testing.assert_allclose(table[name].to_numpy()[order], truth[name], atol=1e-6)
    meta = pq.read_schema(facts["output"]).field("planarity_r100").metadata
    assert b"(l2 - l3) / l1" in meta[b"meaning"]


def test_features_are_those_of_the_stage(made, truth):
    _, table = made
    own = [n for n in NAMES if n not in ("height_above_ground", "echo_number")]
    alone = noise(truth["x"], truth["y"], truth["z"], np.ones(truth.rows, bool), conf.section("ground").noise)
    assert 0 < alone.sum() < 20
    echoes = Chunk(truth.with_columns({"noise": alone}), np.arange(truth.rows), Tile(0, 0, 1e7))
    expected = features(echoes, own, conf.section("features"))
    order = np.lexsort((table["echo_number"], table["pulse"]))
    for name in own:
        np.testing.assert_array_equal(table[name].to_numpy()[order], expected[name], err_msg=name)
    low = truth["source_class"] == 2
    height = table["height_above_ground"].to_numpy()[order]
    inner = ((truth["x"] - 500_000) > 2) & ((truth["x"] - 500_000) < 28)
    np.testing.assert_allclose(height[low], 0.0, atol=0.1)  # the terrain is thinned
    assert np.nanmin(height[~low & inner]) > 2.5


def test_the_size_of_tiles_changes_no_byte(made, las, tmp_path):
    facts, _ = made
    for size in ("7", "13.5"):
        output = tmp_path / f"{size}.parquet"
        again = features_file(FeaturesJob(las, output, listed=",".join(NAMES), settings=(f"tile.size={size}",)))
        assert again["tiles"] > facts["tiles"]
        assert output.read_bytes() == las.with_suffix(".parquet").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["13.5.parquet", "7.parquet"]


def test_what_the_file_cannot_give_is_told_or_left_out(las, tmp_path):
    output = tmp_path / "o.parquet"
    names = "echo_number,width,backscatter,width_std_k20,zc"
    with pytest.raises(ConfigError, match="3 of the 5 features") as fault:
        features_file(FeaturesJob(las, output, listed=names))
    assert "width, width_std_k20" in str(fault.value) and "--features echo_number,zc" in str(fault.value)
    assert "--trajectory" in str(fault.value)
    assert not output.exists()
    facts = features_file(FeaturesJob(las, output, listed=names, skip_missing=True))
    assert list(facts["left_out"]) == ["width", "backscatter", "width_std_k20"]
    assert facts["features"] == ["echo_number", "zc"]


def test_a_text_has_places_and_perhaps_classes(truth, tmp_path):
    source, output = tmp_path / "a.txt", tmp_path / "a.parquet"
    np.savetxt(source, np.stack([truth["x"], truth["y"], truth["z"]], axis=1)[:500], fmt="%.3f")
    facts = features_file(FeaturesJob(source, output, listed="height_std_k20"))
    assert facts["echoes"] == pq.read_table(output).num_rows == 500
    assert "source_class" not in pq.read_schema(output).names
    for name in ("echo_number", "egi_k20", "intensity_mean_k20", "pulse_intensity_variance"):
        with pytest.raises(ConfigError, match="cannot give"):
            features_file(FeaturesJob(source, output, listed=name, overwrite=True))
    with pytest.raises(InputError, match="no ground"):
        features_file(FeaturesJob(source, output, listed="height_above_ground", own_ground=True, overwrite=True))
    assert features_file(FeaturesJob(source, output, listed="height_above_ground", overwrite=True))["echoes"] == 500


def test_classes_of_the_file_are_ground_only_when_asked(las, tmp_path):
    """They may be a reference: features that know it would be learned from what they are to tell."""
    names = "height_above_ground,height_std_k20"
    moved = laspy.read(las)
    moved.classification[:] = np.where(np.asarray(moved.classification) == 2, 6, 2)
    moved.write(tmp_path / "other.las")
    for source, own, same in (("other.las", False, True), ("other.las", True, False)):
        paths = [
            features_file(FeaturesJob(p, tmp_path / f"{p.stem}{own}.parquet", listed=names, own_ground=own))
            for p in (las, tmp_path / source)
        ]
        one, two = (pq.read_table(p["output"])["height_above_ground"].to_numpy() for p in paths)
        assert np.array_equal(one, two, equal_nan=True) == same


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--set", "nowhere"], "no such feature set"),
        (["--features", "planarity"], "lacks its scale"),
        (["--features", "planarity_g100"], "other neighbourhoods"),
        (["--features", "planarty_r100"], "did you mean"),
        (["--set", "fan2013", "--features", "zc"], "named twice"),
        (["--set", "fan2013", "--set", "shi2019"], "two"),
        (["--set", "train.trees=3"], "no effect here"),
        (["--features", "count_c50000"], "reaches too far"),
        (["--features", "planarty_k20"], "did you mean 'planarity_k20'?"),
        (["--features", "planarity_k0"], "positive"),
        (["--features", "height_std_r0"], "size must be positive"),
        (["--features", "planarity_k501"], "at most 500"),
        (["--features", "height_std_r0100"], "without leading 0"),
        (["--set", "nowhere"], "where: --set"),
        (["--features", "x"], "not a feature"),
        (["--features", ","], "no feature is named"),
    ],
)
def test_wrong_words_are_refused(las, tmp_path, words, says):
    result = CliRunner().invoke(cli, ["features", str(las), str(tmp_path / "o.parquet"), *words])
    assert isinstance(result.exception, ConfigError)
    assert says in str(result.exception)


def test_outputs_are_not_replaced(las, made, tmp_path):
    with pytest.raises(ConfigError, match="exists"):
        features_file(FeaturesJob(las, las.with_suffix(".parquet"), listed="zc"))
    with pytest.raises(ConfigError, match="GeoParquet"):
        features_file(FeaturesJob(las, tmp_path / "o.laz", listed="zc"))


def test_a_place_that_cannot_be_written_is_named(las):
    """Root may write everywhere, as far as permissions tell; nobody makes files in /proc."""
    output = Path("/proc/e.parquet")
    if not output.parent.is_dir():
        pytest.skip("no /proc on this system")
    with pytest.raises(ConfigError, match=r"cannot be written(.|\n)*where: /proc/e.parquet"):
        features_file(FeaturesJob(las, output, listed="zc"))


def test_one_of_a_thing_is_told_as_one():
    facts = {
        "input": "a",
        "echoes": 1,
        "features": ["zc"],
        "set": "--features",
        "notes": [],
        "reach": 1.0,
        "tiles": 1,
        "left_out": {},
        "without_value": {},
        "output": "b",
        "bytes": 1,
        "seconds": {"compiling": 0.0, "all": 1.0},
    }
    told = describe(facts)
    assert "1 echo, 1 feature of" in told and told.splitlines()[1].endswith("; 1 tile")
    assert "2 features of" in describe({**facts, "features": ["zc", "egi_r50"]})


def test_the_list_shows_every_feature_and_set():
    result = CliRunner().invoke(cli, ["features", "--list"])
    assert result.exit_code == 0
    for text in ("planarity", "(l2 - l3) / l1", "xiong2018", "127", "Fan 2013, eq. 2", "deg"):
        assert text in result.stdout
    facts = json.loads(CliRunner().invoke(cli, ["features", "--list", "--json"]).stdout)
    assert {s["name"] for s in facts["sets"]} == set(shipped_sets())
    assert {"name", "unit", "formula", "scales", "source"} <= set(facts["features"][0])


@pytest.mark.parametrize("words", [["--list", "xiong2018"], ["--list", "--set", "xiong2018"]])
def test_the_list_of_one_set(words):
    result = CliRunner().invoke(cli, ["features", *words, "--json"])
    facts = json.loads(result.stdout)
    assert [f["name"] for f in facts["features"]] == list(feature_set("xiong2018").features)
    assert all(f["formula"] for f in facts["features"])
    assert "eigenvalue_2_r150" in CliRunner().invoke(cli, ["features", *words]).stdout


def test_an_unknown_set_names_the_option_that_asked():
    for words, where in ((["--list", "fan2014"], "where: --list"), (["--list", "--set", "fan2014"], "where: --set")):
        result = CliRunner().invoke(cli, ["features", *words])
        assert isinstance(result.exception, ConfigError) and where in str(result.exception)


def test_a_set_file_of_ones_own(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("features: [zc]\neach:\n  - {bases: [planarity, height_std], scales: [r60, k20]}\n")
    named, settings = sorted_settings([str(path), "features.cell_x=10"])
    assert settings == ("features.cell_x=10",)
    assert requested_features(named, None).names == (
        "zc",
        "planarity_r60",
        "height_std_r60",
        "planarity_k20",
        "height_std_k20",
    )


@pytest.mark.slow
def test_waveforms_are_decomposed_first(tmp_path):
    source, output = tmp_path / "w.las", tmp_path / "w.parquet"
    lasmaker.survey(source, pulses=300, point_format=9)
    names = "amplitude,width,planarity_k20,backscatter"
    facts = features_file(FeaturesJob(source, output, listed=names, settings=("radiometry.platform_altitude=900",)))
    table = pq.read_table(output)
    assert facts["echoes"] == table.num_rows >= 500
    for name in ("amplitude", "width", "backscatter"):
        values = table[name].to_numpy()
        assert np.nanmedian(values) > 0
        assert np.isfinite(values).mean() > 0.9
    with pytest.raises(ConfigError, match="no ranges"):
        features_file(FeaturesJob(source, output, listed=names, overwrite=True))


def test_parameters_adapted_to_a_hall_make_it_stand_above_the_ground(tmp_path):
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0, 160, (2, 50_000))
    hall = (abs(x - 80) < 35) & (abs(y - 80) < 35)
    z = 100 + 0.02 * x + rng.normal(0, 0.02, len(x)) + np.where(hall, 8.0, 0.0)
    lasmaker.write_las(tmp_path / "a.las", np.c_[500_000 + x, 5_400_000 + y, z], point_format=6)
    heights = {}
    for auto in (False, True):
        job = FeaturesJob(tmp_path / "a.las", tmp_path / "a.parquet", listed="height_above_ground", overwrite=True)
        summary = features_file(replace(job, auto=auto, settings=("ground.max_building_size=20",)))
        table = pq.read_table(tmp_path / "a.parquet").to_pandas()
        middle = (abs(table.x - 500_080) < 20) & (abs(table.y - 5_400_080) < 20)
        heights[auto] = table.height_above_ground[middle].median()
        assert any("are wider than ground.max_building_size" in note for note in summary["notes"]) != auto
        assert any("with max_building_size" in note for note in summary["notes"]) == auto, summary["notes"]
    assert abs(heights[False]) < 0.5 and abs(heights[True] - 8) < 0.2
