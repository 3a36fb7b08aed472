"""Answers that are kept while there is room for them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Condition
from typing import Any


class Cache:
    """Answers that are kept up to a number of bytes, the longest unused ones go; each is made once at a time."""

    def __init__(self, most: int) -> None:
        self.most, self.held = most, 0
        self._kept: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._under_way: set[Hashable] = set()
        self._changed = Condition()

    def get(self, key: Hashable, make: Callable[[], Any], size: Callable[[Any], int] = len) -> Any:
        """What `make` gives; `size` tells its bytes. What raises is not kept."""
        with self._changed:
            while key in self._under_way:
                self._changed.wait()
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key][0]
            self._under_way.add(key)
        try:
            value = make()
            self._keep(key, value, size(value))
            return value
        finally:
            with self._changed:
                self._under_way.discard(key)
                self._changed.notify_all()

    def _keep(self, key: Hashable, value: Any, size: int) -> None:
        with self._changed:
            self._kept[key] = value, size
            self.held += size
            while self.held > self.most and len(self._kept) > 1:
                _, (_, freed) = self._kept.popitem(last=False)
                self.held -= freed
