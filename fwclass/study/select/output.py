"""Files of a selection: the feature set, all numbers, a picture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fwclass.conf import Config
from fwclass.conf.sets import feature_set
from fwclass.errors import ConfigError
from fwclass.features.names import is_feature
from fwclass.graph.stage import Plan
from fwclass.graph.stages import providers
from fwclass.publish.files import check_free, written_whole
from fwclass.publish.selection_curves import draw_selection
from fwclass.store.atomic import write_json
from fwclass.study.select import result
from fwclass.study.select.thinning import THINNING, describe_thinning, draw, setting


def candidates_of(config: Config, text: str | None) -> tuple[str, ...]:
    """Names from a list ``a,b,c``, a feature set's name or file; those of the survey if nothing is given."""
    if text is None:
        return config.features_asked
    if "," in text or text in providers(Plan(config)) or is_feature(text):
        return tuple(word.strip() for word in text.split(",") if word.strip())
    return feature_set(text, config.path.parent, "--candidates").features


def check_target(target: Path | None, root: Path, method: str, overwrite: bool) -> Path:
    """Where the result goes; in the run directory it is replaced, elsewhere only if allowed."""
    if target is None:
        return root / "select" / f"{method}.yaml"
    if target.suffix not in (".yaml", ".yml"):
        raise ConfigError("the result is a YAML file", where="--to", expected="a name that ends in .yaml", got=target)
    for path in (target, *_beside(target)):
        check_free(path, overwrite)
    return target


def _beside(path: Path) -> tuple[Path, Path]:
    return path.with_suffix(".json"), path.with_suffix(".png")


def write(selection: Mapping[str, Any], path: Path) -> None:
    """The YAML at `path`, all numbers and the picture beside it."""
    numbers, picture = _beside(path)
    if selection["method"] == THINNING:
        text, drawn = setting(selection), draw(selection)
    else:
        title = f"{selection['survey']}: {result.TITLES[selection['method']]}"
        text = result.scales_file(selection) if selection["method"] == "scales" else result.set_file(selection)
        drawn = draw_selection(result.curve_of(selection), selection["front"], selection["chosen"], title)
    for place, data in ((picture, drawn), (path, text.encode())):
        with written_whole(place) as beside:
            beside.write_bytes(data)
    write_json(numbers, dict(selection))


def describe(selection: Mapping[str, Any], path: Path) -> str:
    """What to tell on the terminal."""
    numbers, picture = _beside(path)
    text = describe_thinning(selection) if selection["method"] == THINNING else result.describe(selection)
    return f"{text}\n\n{path}\n{numbers}\n{picture}"
