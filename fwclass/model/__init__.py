"""Classes, the sample matrix and trained models: arrays and a card without code, safe from a stranger."""

from __future__ import annotations

from fwclass.classes import ClassDef, class_index, code_index
from fwclass.classifiers import ClassifierMethod
from fwclass.model.base import FORMAT, LEAF, Model, sample_matrix
from fwclass.model.boosted import Boosted, scores_of
from fwclass.model.contextual import Contextual
from fwclass.model.forest import Forest, Tree, assemble
from fwclass.model.layered import LAYERS, Layered, TwoLayer
from fwclass.model.machines import KernelMachine, LinearMachine, Machine, Preparation

__all__ = [
    "FORMAT",
    "KINDS",
    "LAYERS",
    "LEAF",
    "Boosted",
    "ClassDef",
    "ClassifierMethod",
    "Contextual",
    "Forest",
    "KernelMachine",
    "Layered",
    "LinearMachine",
    "Machine",
    "Model",
    "Preparation",
    "Tree",
    "TwoLayer",
    "assemble",
    "class_index",
    "code_index",
    "sample_matrix",
    "scores_of",
]

KINDS: dict[str, type[Model]] = {
    m.kind: m for m in (Forest, Boosted, LinearMachine, KernelMachine, TwoLayer, Contextual)
}
"""Every kind of model, by the name that its card has."""
