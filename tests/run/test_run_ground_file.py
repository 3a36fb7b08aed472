"""Names of parameters, presets, and the classes that points get."""

import numpy as np
import pytest

from fwclass import conf
from fwclass.errors import ConfigError
from fwclass.ground.filters import FILTERS, Flags
from fwclass.read.cloud import read_point_cloud
from fwclass.single_file.ground.file import classes_of, shown_points
from fwclass.single_file.ground.params import ALIASES, ground_params, names_of, used_params

PRESETS = ("wilderness", "nature", "town", "city", "metro", "dense-forest", "steep")


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("method", [*FILTERS, None])
def test_every_preset_suits_every_filter_and_says_what_it_is_for(name, method):
    params = ground_params(method, name)
    assert params.max_building_size == conf.presets()[name]["max_building_size"]
    assert len(conf.presets()[name]["about"]) > 10
    assert set(PRESETS) == set(conf.presets())


def test_presets_lie_between_the_base_and_a_survey(tmp_path):
    base = conf.load("demo")
    text = (conf.conf_directory() / "surveys" / "demo.yaml").read_text()
    own = tmp_path / "s.yaml"
    own.write_text(text.replace("ground:", "ground:\n  preset: steep"))
    made = conf.load(own)
    assert made.ground.max_building_size == base.ground.max_building_size  # the survey's own key
    assert made.ground.smrf.slope == conf.presets()["steep"]["smrf"]["slope"] != base.ground.smrf.slope
    assert conf.load("demo", ("ground.preset=steep",)).ground == made.ground
    assert conf.load(own, ("ground.smrf.slope=0.9",)).ground.smrf.slope == 0.9
    assert conf.load(own, ("ground.preset=null",)).ground == base.ground
    with pytest.raises(ConfigError, match="no such preset"):
        conf.load("demo", ("ground.preset=stepe",))


def test_other_programs_names():
    own = ground_params("csf", None, ("resolution=2", "threshold=0.3", "step=0.5", "sloop_smooth=false"))
    assert (own.csf.cloth_resolution, own.csf.class_threshold, own.csf.time_step) == (2.0, 0.3, 0.5)
    assert own.csf.slope_smooth is False
    assert ground_params("csf", None, ("smooth=false",)).csf == ground_params("csf", None, ("slope_smooth=false",)).csf
    for section, names in ALIASES.items():
        fields = type(getattr(ground_params("smrf"), section)).model_fields
        assert set(names.values()) <= set(fields)


def test_two_sections_are_searched_and_a_dot_picks_one():
    made = ground_params("csf+smrf", None, ("csf.rigidness=2", "cell=2", "resolution=3")).csf_smrf
    assert (made.csf.rigidness, made.smrf.cell, made.csf.cloth_resolution) == (2, 2.0, 3.0)
    with pytest.raises(ConfigError, match=r"csf\.class_threshold=0\.4 or smrf\.threshold=0\.4"):
        ground_params("csf+smrf", None, ("threshold=0.4",))
    made = ground_params("csf+smrf", None, ("smrf.threshold=0.4", "max_building_size=50"))
    assert made.csf_smrf.smrf.threshold == 0.4 and used_params(made)["smrf"]["window"] == 25.0


def test_a_consensus_passes_names_on():
    made = ground_params("consensus", None, ("votes=1", "smrf.slope=0.31", "noise.low=false"))
    assert made.consensus.votes == 1 and made.smrf.slope == 0.31 and not made.noise.low
    assert used_params(made)["smrf"]["slope"] == 0.31


@pytest.mark.parametrize("method", FILTERS)
def test_every_parameter_has_one_name(method):
    params = ground_params(method)
    names = names_of(params)
    reached = {places[0] for places in names.values() if len(places) == 1}
    section = method.replace("-", "_").replace("+", "_")
    own = getattr(params, section)
    for name, value in own.model_dump().items():
        inside = [(section, name, n) for n in value] if isinstance(value, dict) else [(section, name)]
        assert set(inside) <= reached
    with pytest.raises(ConfigError, match="max_building_size"):
        ground_params(method, None, ("no_such_thing=1",))


def test_classes_of_points(tmp_path):
    codes = [2, 2, 5, 7, 18, 0, 6]
    lines = [f"{i} {i} 0 {c}" for i, c in enumerate(codes)]
    (tmp_path / "a.txt").write_text("x y z class\n" + "\n".join(lines))
    cloud = read_point_cloud(tmp_path / "a.txt")
    flags = Flags(np.array([1, 0, 1, 0, 0, 0, 0], bool), np.array([0, 0, 0, 0, 0, 1, 0], bool))
    assert classes_of(cloud, flags, False).tolist() == [2, 1, 2, 1, 1, 7, 1]
    assert classes_of(cloud, flags, True).tolist() == [2, 1, 2, 7, 18, 7, 6]
    assert shown_points(cloud, True).tolist() == [True, True, True, False, False, True, True]
    assert shown_points(cloud).all()
