"""Recorded waveforms of a run, found by strip and pulse."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fwclass.delivery.echoes import Echoes
from fwclass.errors import InputError
from fwclass.run.inputs import PartInputs
from fwclass.store.run_store import Store


@dataclass(frozen=True)
class Waveform:
    """One pulse's recording.

    `time`: shape (n,), of every sample from the first one of the pulse [ns]. `samples`: shape (n,) [DN]; segments one
    after the other. `echoes`: pyarrow table of the pulse's echoes as delivered.
    """

    strip: int
    pulse: int
    time: NDArray[np.float64]
    samples: NDArray[np.uint16]
    echoes: Any


def waveform_of(store: Store, echoes: Echoes, strip: int, pulse: int) -> Waveform:
    """The waveform of a pulse; `InputError` where the run keeps none of it."""
    inputs = PartInputs(store)
    for receipt in store.receipts("read"):
        if receipt.part.split("-")[0] != f"{strip:05d}" or not receipt.meta.get("waveforms"):
            continue
        pulses = inputs.table("read", receipt.part, ("pulse", "segment_start", "sample_spacing"), "pulses.parquet")
        rows = np.flatnonzero(pulses["pulse"] == pulse)
        if not len(rows):
            continue
        arrays, _ = inputs.arrays("read", receipt.part, "waveforms", ("samples", "offsets"))
        offsets = arrays["offsets"]
        pieces = [arrays["samples"][offsets[r] : offsets[r + 1]] for r in rows]
        times = [
            float(pulses["segment_start"][r]) + np.arange(len(piece)) * float(pulses["sample_spacing"][r])
            for r, piece in zip(rows, pieces, strict=True)
        ]
        return Waveform(strip, pulse, np.concatenate(times), np.concatenate(pieces), echoes.to_arrow())
    raise InputError(
        "this run has no such waveform",
        where=store.where,
        expected="a pulse of a strip with waveforms, as the echoes' columns strip and pulse name it",
        got=f"strip {strip}, pulse {pulse}",
        do="look it up in .echoes(); strips of discrete returns have no waveforms"
        if next(store.receipts("read"), None) is not None
        else "the run keeps no waveforms any more (`fwclass clean`, or a copy of its delivery alone): run it again",
    )
