"""How good a model is on data that it has not seen: each of a survey's sources left out in turn."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from fwclass.conf import Config
from fwclass.conf.sections import AreaFilesSection
from fwclass.errors import ConfigError, InputError
from fwclass.run.runner import Runner
from fwclass.study.training import training
from fwclass.survey.area_files import with_areas

FIGURES = ("overall_accuracy", "kappa", "mean_iou")


def leave_out(config: Config, runner: Runner) -> list[dict[str, Any]]:
    """For each of ``survey.sources`` what a model of all others has right there; plain data.

    `source` is the file or pattern, ``overall_accuracy``, ``kappa`` and ``mean_iou`` as in `figures`, ``echoes`` how
    many were judged, ``confusion`` the matrix, ``unsure`` the share of them with a confidence below 0.6. Echoes within
    `areas.gap` of the others' boxes are not judged: neighbours of what trained flatter. Features are computed once:
    only what trains and tests differs.

    `ConfigError`: there is one source, or they are still to be simulated.
    """
    sources = config.survey.sources
    if len(sources) < 2 or config.simulated:
        raise ConfigError(
            "one source cannot be left out",
            where=f"{config.path}: survey.sources",
            expected="two or more files or patterns, each a survey or a part that lies apart",
            got="a survey to be simulated" if config.simulated else ", ".join(sources),
            do="name them one by one, or leave out --leave-out",
        )
    results = []
    for source in sources:
        others = tuple(s for s in sources if s != source)
        by = {"train_by": AreaFilesSection(files=others), "test_by": AreaFilesSection(files=(source,))}
        areas = config.areas.model_copy(update={"train": (), "test": (), **by})
        runner.display.say(f"without {source}")
        try:
            result = training(with_areas(replace(config, areas=areas)), runner, assess=True)
        except InputError as fault:
            runner.display.say(f"note: {fault.what}: {source} tells nothing")
            continue
        if not result["accuracy"]:
            runner.display.say(f"note: all of {source} lies within {areas.gap:g} m (areas.gap) of the others")
        if accuracy := result["accuracy"]:
            matrix = accuracy["confusion"]
            facts = {"source": source, "echoes": sum(map(sum, matrix)), "confusion": matrix, "unsure": result["unsure"]}
            results.append(facts | {n: accuracy[n] for n in FIGURES})
    return results
