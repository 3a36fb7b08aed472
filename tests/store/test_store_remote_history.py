"""The history of a run on object storage: an object a line, in order by its name, of bounded number."""

from __future__ import annotations

import pytest
from objectstore import Server, quick

from fwclass.store import history
from fwclass.store.bucket import Remote
from fwclass.store.run_store import Store


@pytest.fixture
def remote(s3: Server) -> Remote:
    return Remote(s3.url(), quick())


def run(remote: Remote, name: str, hour: int, *records: str) -> None:
    for record in records or ("begin", "end"):
        history.append(remote, {"record": record, "id": name, "began": f"2026-03-01T{hour:02d}:00:00Z"})


def told(remote: Remote, last: int | None = None) -> list[str]:
    return [f"{line['id']} {line['record']}" for line in history.lines(remote, last)]


def test_runs_are_in_the_order_of_their_beginnings_and_an_end_stands_for_its_beginning(s3, remote):
    run(remote, "b", 2)
    run(remote, "a", 3, "begin")
    run(remote, "c", 1)
    history.append(remote, {"record": "told", "id": "b", "told": {}})
    assert told(remote) == ["c end", "b end", "b told", "a begin"]
    assert told(remote, 2) == ["b end", "b told", "a begin"]
    assert [line["record"] for line in history.lines_of(remote, "b")] == ["end", "told"]
    assert list(history.lines_of(remote, "none")) == []
    assert "store/history/20260301T020000Z-b-end.json" in s3.keys(remote.url)


def test_what_is_no_line_is_passed_over(s3, remote):
    run(remote, "a", 1)
    run(remote, "../../lock", 2)
    for name in ("20260301T000000Z-x-end.json", "readme.txt", "20260301T000000Z-x-other.json"):
        s3.write(remote.url / "store/history" / name, b"\xff half")
    assert told(remote) == ["a end", "../../lock end"]
    assert [line["id"] for line in history.lines_of(remote, "../../lock")] == ["../../lock"]
    assert all(key.startswith("store/history/") for key in s3.keys(remote.url))


def test_who_next_holds_the_lock_removes_the_oldest(s3, remote, monkeypatch):
    monkeypatch.setattr(history, "KEPT", 3)
    for hour in range(6):
        run(remote, f"r{hour}", hour)
    history.append(remote, {"record": "told", "id": "r0", "told": {}})
    run(remote, "r6", 6, "begin")
    Store(remote, lists=True).clear_staging()
    assert told(remote) == ["r4 end", "r5 end", "r6 begin"]
    assert len(s3.keys(remote.url)) == 5
