"""Parameters of the classification."""

from __future__ import annotations

from fwclass.stage import Params


class ClassifyParams(Params):
    """What is written; everything that decides comes from the model.

    `probabilities`: the share of every class too, in columns ``probability_<code>``.
    """

    probabilities: bool
