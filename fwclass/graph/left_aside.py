"""Waveforms that are left aside, where the sources' own returns tell all that is asked."""

from __future__ import annotations

from fwclass.errors import ConfigError
from fwclass.graph.sources import MEASURE_PULSE, strips_declared
from fwclass.graph.stage import Plan
from fwclass.store.run_store import Store

LEFT_ASIDE = "by the returns of the sources: their waveforms are left aside"
"""What is said of it, by a run and in its report."""


def left_aside(plan: Plan, store: Store) -> bool:
    """Whether the sources have waveforms and every one has returns too, so that these are taken for echoes.

    `quality.echoes` ``auto`` keeps to the echoes of waveforms where `store` has some: to make tiles of returns there
    would cost more, and take them from who needs them. `ConfigError` where returns are asked for (there, or by
    `survey.echoes`) and a file has none.
    """
    strips = strips_declared(plan)
    lacking = [s for s in strips if not plan.indexed["index", s.key].meta["points"]]
    of_survey = plan.config.survey.echoes == "returns"
    asked = of_survey or plan.config.quality.echoes == "returns"
    if lacking and asked:
        raise ConfigError(
            "a source has waveforms alone, and no returns to judge by",
            where=f"{plan.config.path}: {'survey' if of_survey else 'quality'}.echoes",
            got=f"returns, and {lacking[0].path.name} has none",
            do=f"--set {'survey' if of_survey else 'quality'}.echoes=waveforms",
        )
    held = any(store.receipt(MEASURE_PULSE.name, s.key) for s in strips)
    return bool(strips) and not lacking and (asked or not held)
