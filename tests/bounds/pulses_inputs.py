"""Pulse files, some with samples of two widths run together, whose bytes were changed, read whole."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from plsmaker import run_together, survey

from fwclass.errors import InputError
from fwclass.read import pls_read
from fwclass.read.pls_read import index_pls, read_pls
from fwclass.read.pulsewaves import open_pls

CHANGED = 6
"""Bytes of either file that are changed, at most."""


def drive(inputs: int, seed: int) -> int:
    """Every pulse whose samples may have been run together is taken for such, whatever its file's first ones say."""
    rng = np.random.default_rng(seed)
    pls_read._runs_together = lambda asked: True
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.pls"
        survey(path, 12, bits=16, two_segments=0.0)
        run_together(path)
        sound = {p: np.frombuffer(p.read_bytes(), np.uint8) for p in (path, path.with_suffix(".wvs"))}
        for _ in range(inputs):
            for file, data in sound.items():
                changed = data.copy()
                first = int(rng.choice([60, len(data) - 48 * 12])) if file == path else 60
                at = rng.integers(first, len(data), rng.integers(0, CHANGED + 1))
                changed[at] = rng.choice([0, 1, 127, 128, 255, rng.integers(256)], len(at))
                file.write_bytes(changed[: len(data) - rng.choice([0, 0, rng.integers(200)])].tobytes())
            try:
                source = open_pls(path)
                for span in index_pls(source, 5):
                    read_pls(source, span)
            except InputError:
                pass
    return inputs
