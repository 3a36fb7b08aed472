"""One S3 server for all tests of the store, and a directory for this process' copies."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from objectstore import Server, serving, used


@pytest.fixture(scope="session")
def s3_server() -> Iterator[Server]:
    with serving() as server:
        yield server


@pytest.fixture
def s3(s3_server: Server, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Server:
    for name, value in used(s3_server, tmp_path / "copies").items():
        monkeypatch.setenv(name, value)
    return s3_server
