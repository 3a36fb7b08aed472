"""In which order the tests are done, and which of them by one process, where several processes share the suite.

A kernel takes up to a minute to compile, once: the kernels' own tests come first, so that no two processes compile the
same one. Whole runs follow, the longest files before the others, and the quick tests fill what is left.
"""

from __future__ import annotations

from typing import Any

import pytest
from xdist.scheduler import LoadScopeScheduling

FIRST = (
    "tests/decompose/",
    "tests/features/",
    "tests/ground/",
    "tests/simulate/",
    "tests/train/",
    "tests/classify/",
    "tests/faults/",
    "tests/run/",
    "tests/view/",
    "tests/test_cli",
    "tests/store/",
    "tests/security/",
    "tests/fuzz/",
)
"""Beginnings of the paths of what comes first, in this order."""

TOGETHER = ("tests/decompose/", "tests/features/", "tests/faults/", "tests/run/", "tests/view/")
"""Folders whose files share the kernel that takes longest to compile, or one run: one process does them all."""


def place(path: str) -> int:
    """The place of a test in the order."""
    return next((k for k, begin in enumerate(FIRST) if path.startswith(begin)), len(FIRST))


class Files(LoadScopeScheduling):
    """Hands whole files to the processes, in the order of the tests."""

    def __init__(self, config: pytest.Config, log: Any = None) -> None:
        super().__init__(config, log)
        config.option.loadscopereorder = False

    def _split_scope(self, nodeid: str) -> str:
        path = nodeid.split("::", 1)[0]
        return next((folder for folder in TOGETHER if path.startswith(folder)), path)
