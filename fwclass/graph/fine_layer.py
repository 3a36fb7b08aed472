"""The second layer that a run has: of the settings, or of the model that is given."""

from __future__ import annotations

from dataclasses import dataclass

from fwclass.features.names import FeatureRequest
from fwclass.graph.loaded_models import model_at
from fwclass.graph.stage import Plan
from fwclass.model import TwoLayer
from fwclass.store.remote_file import local


@dataclass(frozen=True)
class FineLayer:
    """The second layer: where it answers, and what it decides by.

    Attributes
    ----------
    pair : class codes of the two classes that meet.
    within : echoes with an answer of the other class as near as this are at the boundary [m].
    names : features that it decides by, in order.
    wide : those of them that are computed at the boundary alone.
    """

    pair: tuple[int, int]
    within: float
    names: tuple[str, ...]
    wide: tuple[str, ...]

    def halo(self, plan: Plan) -> float:
        """What it reads around a tile [m]."""
        return max(self.within, FeatureRequest.of(self.wide).halo(plan.config.features))


def fine_layer(plan: Plan) -> FineLayer | None:
    """The second layer of a run, None without one."""
    if plan.model is not None:
        model = model_at(local(plan.model[0]), plan.model[1], True)
        return _layer(plan, model.pair, model.within, model.fine.features) if isinstance(model, TwoLayer) else None
    params = plan.config.classify.refine
    if not params.between:
        return None
    codes = [next(c.code for c in plan.config.classes if c.name == name) for name in params.between]
    coarse = plan.config.features_asked if params.features == "shares+coarse" else ()
    return _layer(plan, (codes[0], codes[1]), params.within, tuple(dict.fromkeys((*params.shares, *coarse))))


def _layer(plan: Plan, pair: tuple[int, int], within: float, names: tuple[str, ...]) -> FineLayer:
    computed = {*plan.names, *plan.computed}
    return FineLayer(pair, within, names, tuple(n for n in names if n not in computed))
