"""The names of the classifiers; a module that loads nothing, for the command line."""

from __future__ import annotations

from typing import Literal

ClassifierMethod = Literal["forest", "linear-svm", "rbf-svm", "sklearn-forest", "boosting"]
"""Classifiers that can be trained, by the name that ``train.method`` takes."""
