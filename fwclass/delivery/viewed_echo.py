"""What stands behind an echo, for the viewer: its waveform with the fit, and why it has its class."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass import conf
from fwclass.classify.stage import classify
from fwclass.decompose.params import DecomposeParams
from fwclass.delivery.explain import deciding_values
from fwclass.delivery.opened import Delivery
from fwclass.errors import FwclassError, InputError
from fwclass.graph.context_training import context_sample
from fwclass.graph.sources import pulse_of, span_name, strip_of, waveforms_of
from fwclass.graph.training_rows import load_sample
from fwclass.model import Contextual
from fwclass.run.inputs import PartInputs
from fwclass.store.models import load_model
from fwclass.store.run_store import Store
from fwclass.units import finite_or_none
from fwclass.view.cache import Cache
from fwclass.waveforms import Waveforms

TELLING = 10
"""Features that are told."""

SPANS = 256 << 20
"""Bytes of opened spans of waveforms that are kept."""

FEATURES = 256 << 20
"""Bytes of features of tiles that are kept."""


class BehindEchoes:
    """Reads the run's store, which is not part of the delivery: parts that are gone are told."""

    def __init__(self, delivery: Delivery) -> None:
        self._delivery, self._store = delivery, Store(delivery.root, read_only=True)
        self._inputs, self._spans, self._trained = PartInputs(self._store), Cache(SPANS), Cache(1 << 30)
        self._features = Cache(FEATURES)

    def prepare(self) -> None:
        """Load what the first click would wait for: what fits and draws, the model, the training sample."""
        read = (p for s, p in sorted(self._store.parts()) if s == "read")
        part = next((p for p in read if self._inputs.meta("read", p).get("waveforms")), None)
        if part is not None:
            self.pulse(strip_of(part), int(self._span(part).pulses["pulse"][0]))
        tile = next((p for s, p in self._store.parts() if s == "tile"), None)
        if tile is not None:
            self.why(tile, 0)

    def pulse(self, strip: int, pulse: int) -> dict[str, Any]:
        """Samples, the fitted sum and each echo alone, the residual over the noise, the vendor's returns."""
        from fwclass.single_file.waveforms.pictured import pulse_picture
        from fwclass.single_file.waveforms.shown import see

        waves = self.waves(strip, pulse)
        now = conf.section("decompose").model_dump()  # a run of an earlier version lacks what came since
        params = DecomposeParams(**now | self._delivery.report["config"]["decompose"])
        system = pulse_of(strip, self._inputs)
        view = see(waves, params, system, (pulse,))
        picture, facts = pulse_picture(view, 0, system)
        residual = np.where(picture.clipped, np.nan, (picture.samples - picture.model) / picture.sigma)
        n = len(facts["echoes"])
        says = f"{n} fitted {'echo' if n == 1 else 'echoes'}, {len(picture.vendor)} of the vendor; noise "
        says += f"{facts['noise']:.2f} DN, misfit {facts['misfit']:.2f}; below the residual in units of the noise"
        return {
            "strip": strip,
            "pulse": pulse,
            "says": says,
            "time": _finite(picture.time),
            "samples": _finite(picture.samples),
            "residual": _finite(residual),
            "fine": _finite(picture.fine),
            "total": _finite(picture.total),
            "curves": [_finite(c) for c in picture.curves],
            "vendor": _finite(picture.vendor),
            "echoes": [
                {k: finite_or_none(e[k]) for k in ("time", "amplitude", "amplitude_sigma", "width", "width_sigma")}
                for e in facts["echoes"]
            ],
        }

    def waves(self, strip: int, pulse: int) -> Waveforms:
        """The span of a pulse; which one that is the receipt of the strip's index tells, without opening any.

        `InputError`: none has it.
        """
        spans = self._inputs.meta("index", f"{strip:05d}").get("spans", ())
        part = span_name(strip, bisect_right([first for _, _, first, *_ in spans], pulse) - 1)
        if self._inputs.meta("read", part).get("waveforms"):
            waves = self._span(part)
            if (waves.pulses["pulse"] == pulse).any():
                return waves
        raise InputError(
            "this run has no waveform of the pulse",
            where=self._store.where,
            got=f"strip {strip}, pulse {pulse}",
            do="strips of discrete returns have none, and `fwclass clean` removes them: run again to have them",
        )

    def _span(self, part: str) -> Waveforms:
        return self._spans.get(part, lambda: waveforms_of(part, self._inputs), lambda w: w.samples.nbytes)

    @property
    def has_reference(self) -> bool:
        """The run labelled its echoes, and still has the labels."""
        return any(stage == "label" for stage, _ in self._store.parts())

    def reference(self, tile: str) -> NDArray[np.uint8]:
        """Code of the reference of every echo of a tile, 0 for none; a fault where the run has none any more."""
        return np.asarray(self._inputs.table("label", tile, ("reference",))["reference"])

    def why(self, tile: str, row: int) -> dict[str, Any]:
        """Shares of the classes, and the features whose replacement by what the runner-up usually has turns most.

        Usual is the median of the runner-up's training sample; where the run keeps none (a model that was given), of
        the tile's echoes of that class.
        """
        model = self._delivery.file("model/")
        if not self._delivery.has_model:
            raise InputError("no model voted: these classes are a ground filter's", where=self._delivery.path)
        if not model.is_dir():
            raise InputError("this delivery has no model to ask", where=self._delivery.path)
        forest = self._trained.get("model", lambda: load_model(model), lambda _: 1 << 20)
        names = forest.deciding
        X = self._features.get(tile, lambda: self._matrix(tile, forest), lambda matrix: matrix.nbytes)
        mine = X[[row]]
        shares = {c.name: float(s[0]) for c, s in self._answers(mine, forest)}
        order = sorted(shares, key=lambda name: -shares[name])
        winner, other = order[0], order[1] if len(order) > 1 else order[0]
        medians, of = self._medians(forest, X, tile)
        variants = np.repeat(mine, X.shape[1], axis=0)
        np.fill_diagonal(variants, medians[other][0.5])
        answers = {c.name: s for c, s in self._answers(variants, forest)}
        effects = shares[winner] - answers[winner]
        telling = np.argsort(-effects, kind="stable")[:TELLING].tolist()
        features = [
            {
                "name": names[k],
                "value": finite_or_none(mine[0, k]),
                "own": finite_or_none(medians[winner][0.5][k]),
                "own_low": finite_or_none(medians[winner][0.05][k]),
                "own_high": finite_or_none(medians[winner][0.95][k]),
                "others": finite_or_none(medians[other][0.5][k]),
                "others_low": finite_or_none(medians[other][0.05][k]),
                "others_high": finite_or_none(medians[other][0.95][k]),
                "effect": float(effects[k]),
            }
            for k in telling
        ]
        return {
            "shares": {n: shares[n] for n in order},
            "given": winner,
            "other": other,
            "of": of,
            "features": features,
        }

    def _matrix(self, tile: str, model: Any) -> NDArray:
        """What the model is asked with of a tile, (rows, features)."""
        return deciding_values(self._store, self._inputs, tile, model, self._delivery.table)

    def _answers(self, X: NDArray, forest: Any) -> list[tuple[Any, NDArray]]:
        answers = classify(np.ascontiguousarray(X, np.float32), forest, True)
        return [(c, answers[f"probability_{c.code}"]) for c in forest.classes]

    def _medians(self, forest: Any, X: NDArray, tile: str) -> tuple[Mapping[str, Mapping[float, NDArray]], str]:
        """Quantiles of every class's features, and what they are of."""
        try:
            return self._trained.get("medians", lambda: self._of_training(forest), lambda _: 1 << 20), " in training"
        except (FwclassError, OSError, KeyError):
            return self._trained.get(("medians", tile), lambda: self._here(X, forest), lambda _: 1 << 20), (
                f" in tile {tile}"
            )

    def _here(self, X: NDArray, forest: Any) -> Mapping[str, Mapping[float, NDArray]]:
        return _quantiles(X, self._class_numbers(X, forest), forest)

    def _of_training(self, forest: Any) -> Mapping[str, Mapping[float, NDArray]]:
        sample = load_sample(self._inputs, "training", "all", forest.features)
        if isinstance(forest, Contextual):
            sample = context_sample(self._inputs, sample, forest.deciding[len(forest.features) :])
        return _quantiles(sample.X, sample.y, forest)

    def _class_numbers(self, X: NDArray, forest: Any) -> NDArray:
        """Number of the class of every row."""
        return np.argmax(np.stack([s for _, s in self._answers(X, forest)]), axis=0)


def _quantiles(X: NDArray, y: NDArray, forest: Any) -> Mapping[str, Mapping[float, NDArray]]:
    out = {}
    for number, one in enumerate(forest.classes):
        rows = X[y == number]
        rows = np.where(np.isfinite(rows), rows, np.nan) if len(rows) else np.full((1, X.shape[1]), np.nan)
        finite = np.isfinite(rows).any(axis=0)
        values = {q: np.full(X.shape[1], np.nan) for q in (0.05, 0.5, 0.95)}
        for q, at in values.items():
            at[finite] = np.nanquantile(rows[:, finite], q, axis=0)
        out[one.name] = values
    return out


def _finite(values: NDArray) -> list[float | None]:
    return [round(float(v), 4) if math.isfinite(v) else None for v in values]
