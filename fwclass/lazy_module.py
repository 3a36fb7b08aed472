"""Modules that take long to load, loaded when they are first used: a process that only plans needs few of them."""

from __future__ import annotations

import importlib
from typing import Any


class LazyModule:
    """Stands for the module `name`. Beside it, under `TYPE_CHECKING`, the module itself is imported by that name."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        if attribute.startswith("__"):  # asked by those who look at any object, as pickle does
            raise AttributeError(attribute)
        value = getattr(importlib.import_module(self._name), attribute)
        setattr(self, attribute, value)  # looked up once
        return value
