"""A survey that has no files of its own: simulated before any is looked for."""

from __future__ import annotations

from fwclass.conf import Config
from fwclass.errors import ConfigError, InputError
from fwclass.graph.stage import Plan, Stage
from fwclass.graph.stage_work import Result, StageInputs
from fwclass.run.runner import Runner
from fwclass.simulate.params import SimulateParams
from fwclass.store.url import Url
from fwclass.survey.gather import SIMULATED

TRAJECTORY, TRUTH = "trajectory", "truth"
"""The parts of the simulation that are no strips."""


def simulate_part(here: StageInputs, params: SimulateParams, prefix: str) -> Result:
    """A strip of the simulated survey, or its trajectory, in the directory `prefix`."""
    from fwclass.simulate.flight import plan_strips  # other surveys need not load it
    from fwclass.simulate.stage import simulate_strip, write_trajectory

    directory = here.directory / prefix
    directory.mkdir(parents=True, exist_ok=True)
    if here.part == TRUTH:
        from fwclass.simulate.truth import write_truth

        write_truth(params, directory)
        return {}
    if here.part == TRAJECTORY:
        write_trajectory(params, directory)
        return {}
    facts = dict(simulate_strip(params, next(s for s in plan_strips(params) if s.name == here.part), directory))
    facts.pop("seconds", None)
    return facts


def simulation(prefix: str) -> Stage:
    """The stage that makes a survey, one part for every strip; files go to `prefix` below the run directory."""

    def parts(plan: Plan) -> list[str]:
        from fwclass.simulate.flight import plan_strips

        return [*(s.name for s in plan_strips(plan.config.simulate)), TRAJECTORY, TRUTH]  # type: ignore[arg-type]

    return Stage(
        "simulate",
        1,
        "file",
        "pulse",
        simulate_part,
        when=lambda plan: plan.config.simulate is not None,
        parts=parts,
        arguments=lambda plan: {"params": plan.config.simulate, "prefix": prefix},
        place="run",
    )


SIMULATE = simulation(SIMULATED)


def simulate_survey(config: Config, runner: Runner) -> None:
    """Make the files of a survey that has none of its own; nothing where it has."""
    if config.simulate is None:
        return
    if isinstance(runner.store.where, Url):
        raise ConfigError(
            "a simulated survey cannot lie on object storage",
            where=f"{config.path}: survey.directory",
            do="fwclass simulate CONF --out DIR, copy DIR to object storage, and set survey.directory to it",
        )
    tasks = SIMULATE.tasks(Plan(config))
    if len(runner.do(tasks)) < len(tasks):
        raise InputError("the survey could not be simulated", where=runner.root, do="see the failed parts above")
