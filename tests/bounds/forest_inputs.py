"""Models and samples that try to lead the kernels of training and classification out of their arrays."""

from __future__ import annotations

import contextlib

import modelmaker
import numpy as np

from fwclass import conf
from fwclass.classify.stage import classify
from fwclass.errors import FwclassError
from fwclass.model import LEAF, Forest


def foreign(rng: np.random.Generator) -> Forest:
    """A forest whose nodes, places and thresholds are anything; most are refused when it is made."""
    n = int(rng.integers(1, 12))
    feature = rng.choice([0, 1, 2, 3, LEAF - 1, LEAF, LEAF, LEAF], n).astype(np.uint16)
    child = rng.choice([0, 1, 2, 3, n - 1, n, 2**31, 2**32 - 1], n).astype(np.uint32)
    threshold = rng.choice([0.0, 1.0, -1e30, np.inf, -np.inf, np.nan], n).astype(np.float32)
    ends = ((0, n), (0, n + 1), (1, n), (0, n // 2, n), (0, n, n), (0, -1, n))
    offsets = np.array(ends[int(rng.integers(0, len(ends)))])
    return Forest(feature, threshold, child, offsets, modelmaker.card())


def samples(rng: np.random.Generator) -> np.ndarray:
    """Few to some hundred rows of two features, with what no number compares to."""
    n = int(rng.choice([0, 1, 7, 8, 9, 300]))
    return rng.choice([0.0, 1.0, -1.0, 1e38, -1e38, np.inf, -np.inf, np.nan], (n, 2)).astype(np.float32)


def drive(inputs: int, seed: int) -> int:
    rng = np.random.default_rng(seed)
    params, sound = conf.section("train"), modelmaker.models()
    for done in range(inputs):
        X = samples(rng)
        for model in sound.values():
            with contextlib.suppress(FwclassError):
                classify(X, model, probabilities=done % 2 == 0)
        with contextlib.suppress(FwclassError, ValueError):
            classify(X, foreign(rng))
        if len(X):
            with contextlib.suppress(FwclassError):
                modelmaker.grow_tree(
                    np.where(np.isfinite(X), X, 0.0).astype(np.float32),
                    rng.integers(0, 3, len(X)).astype(np.uint8),
                    3,
                    done,
                    params,
                )
    return inputs
