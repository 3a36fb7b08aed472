"""A model knows which amplitude it learned from, and refuses data of another, before anything is computed."""

from __future__ import annotations

import json

import laspy
import numpy as np
import pytest
from commandline import fwclass
from lasmaker import survey, write_las
from rawmaker import scene, write_parquet

from fwclass.errors import ConfigError
from fwclass.graph.quantities import check_learned, joint_quantities, mixed_note, quantities_by_feature
from fwclass.read.quantities import COUNTS, DECIBELS, FITTED, INTENSITY, NONE, READ, Quantities, quantities_of
from fwclass.read.source import open_source

CONFIG = """
survey:
  name: t
  sources: ["*.las"]
  reference: {{kind: {kind}}}
  features: [height_above_ground, zc, {features}]
  classes: [{{name: ground, code: 2, codes: [2]}}, {{name: vegetation, code: 5, codes: [3, 4, 5]}}]
areas: {{train: [[499000, 5390000, 500005.0, 5410000]], gap: 0.1}}
train: {{trees: 3}}
publish: {{figure_pixels: 200}}
"""
AMPLITUDE = "amplitude, amplitude_mean_c200"
WAVES = Quantities(COUNTS, FITTED)
RIEGL = Quantities(DECIBELS, READ)
PLAIN = Quantities(INTENSITY, NONE)


def discrete(source, target, extra=None):
    """The returns of a file without its waveforms."""
    las = laspy.read(source)
    return write_las(
        target,
        np.column_stack([las.x, las.y, las.z]),
        point_format=6,
        return_number=np.asarray(las.return_number),
        number_of_returns=np.asarray(las.number_of_returns),
        intensity=np.asarray(las.intensity),
        classification=np.asarray(las.classification),
        gps_time=np.asarray(las.gps_time),
        extra=extra,
    )


def write(folder, kind="source", features=AMPLITUDE):
    path = folder / "t.yaml"
    path.write_text(CONFIG.format(kind=kind, features=features))
    return path


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A model of a survey with waveforms, and the same returns as intensities and as decibels."""
    root = tmp_path_factory.mktemp("trained")
    for name in ("waves", "plain", "riegl"):
        (root / name).mkdir()
    survey(root / "waves" / "a.las", 200)
    n = len(laspy.read(root / "waves" / "a.las"))
    discrete(root / "waves" / "a.las", root / "plain" / "b.las")
    extra = {name: ("u2", 0.01, np.full(n, 400)) for name in ("Amplitude", "Pulse width")}
    discrete(root / "waves" / "a.las", root / "riegl" / "c.las", extra)
    ended = fwclass("train", write(root / "waves"), "--model", root / "model", "--workers", 0, cwd=root)
    assert ended.returncode == 0, ended.stderr
    return root


def test_the_card_says_what_was_learned(trained):
    made = json.loads((trained / "model" / "card.json").read_text())["computed"]["quantities"]
    one = {"of": "amplitude", "quantity": "counts", "unit": "DN"}
    assert made == {"amplitude": one, "amplitude_mean_c200": one}


@pytest.mark.parametrize(("name", "words"), [("plain/b", "the returns' intensity"), ("riegl/c", "decibels [dB]")])
def test_data_of_another_quantity_are_refused(trained, tmp_path, name, words):
    ended = fwclass("classify", trained / f"{name}.las", tmp_path / "o.las", "--model", trained / "model")
    assert ended.returncode == 2 and "the model learned from another amplitude" in ended.stderr
    assert words in ended.stderr and "digitiser counts" in ended.stderr and not list(tmp_path.iterdir())
    folder = (trained / name).parent
    model = ("--set", f"survey.model={trained / 'model'}")
    path = write(folder, kind="none")
    ended = fwclass("run", path, *model, "--out", tmp_path / "r", "--workers", 0)
    assert ended.returncode == 2 and "the model learned from another amplitude" in ended.stderr
    assert words in ended.stderr and not list(tmp_path.iterdir()), "before anything is computed"


def test_data_of_the_same_quantity_are_classified(trained, tmp_path):
    ended = fwclass("classify", trained / "waves" / "a.las", tmp_path / "o.las", "--model", trained / "model")
    assert ended.returncode == 0, ended.stderr


def test_a_survey_of_several_quantities_is_refused_where_it_matters(trained, tmp_path):
    for name in ("waves/a.las", "waves/a.wdp", "plain/b.las"):
        (tmp_path / name.split("/")[1]).write_bytes((trained / name).read_bytes())
    for command in (("run", "--out", tmp_path / "r"), ("train", "--model", tmp_path / "m")):
        ended = fwclass(command[0], write(tmp_path), *command[1:], "--workers", 0, cwd=tmp_path)
        assert ended.returncode == 2 and "would mix them" in ended.stderr, ended.stderr
        assert not (tmp_path / "r").exists() and not (tmp_path / "m").exists()
    files = {"a.las": WAVES, "b.las": PLAIN}
    assert joint_quantities(files, ("zc", "echo_number"), "t.yaml") == WAVES, "no feature is made of amplitudes"
    with pytest.raises(ConfigError, match="amplitude_mean_c200"):
        joint_quantities(files, ("zc", "amplitude_mean_c200"), "t.yaml")


def test_what_depends_on_which_quantity():
    names = ("zc", "echo_number", "amplitude_std_k20", "energy", "backscatter", "width_mean_r100", "intensity")
    made = quantities_by_feature(names, RIEGL)
    assert {n: one["quantity"] for n, one in made.items()} == {
        "amplitude_std_k20": DECIBELS,
        "energy": DECIBELS,
        "backscatter": DECIBELS,
        "width_mean_r100": READ,
    }
    assert made["width_mean_r100"]["unit"] == "ns"


def test_old_cards_and_widths_are_told_not_refused():
    old = {"features": ["zc", "amplitude"], "computed": {"ground": "smrf"}}
    assert "does not say which quantity amplitude is made of" in check_learned(old, {"a.las": PLAIN}, "m")[0]
    assert check_learned({"features": ["zc"]}, {"a.las": PLAIN}, "m") == []
    card = {"features": ["width"], "computed": {"quantities": quantities_by_feature(["width"], WAVES)}}
    assert "learned echo widths fitted" in check_learned(card, {"a.las": RIEGL}, "m")[0]
    assert check_learned(card, {"a.las": WAVES}, "m") == []
    for none in ({"width": "fitted"}, {"width": None}, {"width": []}):  # a stranger's
        damaged = {**card, "computed": {"quantities": none}}
        assert "does not say which quantity" in check_learned(damaged, {"a.las": RIEGL}, "m")[0]
    with pytest.raises(ConfigError, match="another echo width"):
        check_learned(card, {"a.las": PLAIN}, "m")


def test_info_says_which(trained):
    for name, one in (("waves/a.las", WAVES), ("plain/b.las", PLAIN), ("riegl/c.las", RIEGL)):
        assert quantities_of(open_source(trained / name)) == one
        ended = fwclass("info", trained / name, "--json")
        assert json.loads(ended.stdout)["quantities"] == one._asdict()
    assert "digitiser counts" in fwclass("info", trained / "waves" / "a.las").stdout


def volts(path, step=None, stray=None):
    """Ground of a scene whose samples are volts, one of which may be far off."""
    columns = scene(pulses=300, scale=1 / 512).columns()
    columns["samples"] = [s + 1e-4 for s in columns["samples"]]
    if stray is not None:
        columns["samples"][7][3] = stray
    return write_parquet(path, columns, {"crs": "EPSG:32632", "spacing_ns": "1.0"} | ({"step": step} if step else {}))


def test_amplitudes_are_counts_of_the_same_step_or_not_compared(tmp_path):
    a, b = volts(tmp_path / "a.parquet"), volts(tmp_path / "b.parquet", stray=90.0)
    files = {p.name: quantities_of(open_source(p)) for p in (a, b)}
    assert files["a.parquet"].amplitude.startswith("steps of ") and files["a.parquet"] != files["b.parquet"]
    with pytest.raises(ConfigError, match="give all files the same `step` in their metadata"):
        joint_quantities(files, ["zc", "amplitude_mean_c200"], "s.yaml")
    joint_quantities(files, ["zc", "energy"], "s.yaml")
    assert "only energies can be compared" in mixed_note(files)[0]
    for path, stray in ((a, None), (b, 90.0)):
        volts(path, step="0.002", stray=stray)
    files = {p.name: quantities_of(open_source(p)) for p in (a, b)}
    assert files["a.parquet"] == files["b.parquet"] == Quantities("steps of 0.002", FITTED) and mixed_note(files) == []
    joint_quantities(files, ["amplitude_mean_c200"], "s.yaml")
    assert fwclass("decompose", a, tmp_path / "a.laz").returncode == 0
    amplitude = np.median(laspy.read(tmp_path / "a.laz")["amplitude DN"])
    assert 60 / 512 / 0.002 < amplitude < 120 / 512 / 0.002
    card = {"features": ["amplitude"], "computed": {"quantities": quantities_by_feature(["amplitude"], files[a.name])}}
    assert check_learned(card, files, "m") == []
    with pytest.raises(ConfigError, match=r"in steps of 0\.002 in the file's samples"):
        check_learned(card, {"c": WAVES}, "m")


@pytest.mark.parametrize("step", ["0", "-1", "x", "1e-9"])
def test_a_step_that_is_none(tmp_path, step):
    path = volts(tmp_path / "a.parquet", step=step)
    ended = fwclass("info", path)
    assert ended.returncode == 1 and "metadata step" in ended.stderr, ended.stderr
