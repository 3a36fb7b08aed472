"""What parts say of delivered strips and tiles is said by the report."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from fwclass.report import remarks


def test_what_strips_lack_and_what_extra_bytes_cannot_hold_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    told: dict[str, list[dict[str, Any]]] = {
        "publish-strip": [
            {"lacking": ["the packet record ends 10 bytes past the file"]},
            {"lacking": []},
            {},  # of a run before it was told
            {"lacking": ["the packet record ends 10 bytes past the file"]},
        ],
        "publish-tile": [{"beyond": {"Amplitude": 3}}, {"beyond": {}}, {"beyond": {"Amplitude": 4, "Reflectance": 1}}],
    }

    def receipts(runner: object, stage: str) -> list[Any]:
        return [SimpleNamespace(part=f"s{k}", meta=meta) for k, meta in enumerate(told.get(stage, []))]

    monkeypatch.setattr(remarks, "receipts_of_run", receipts)
    assert remarks.remarks_of_parts(SimpleNamespace(outcomes={})) == [  # type: ignore[arg-type]
        "delivered strips s0, s3: the packet record ends 10 bytes past the file",
        "values beyond what an extra byte of the LAZ tiles holds are its least or greatest one there (Amplitude 7, "
        "Reflectance 1); the Parquet files have them",
    ]
    told.clear()
    assert remarks.remarks_of_parts(SimpleNamespace(outcomes={})) == []  # type: ignore[arg-type]
