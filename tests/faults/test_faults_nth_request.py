"""The n-th request to object storage fails, or is done and not answered, for every n; or the network goes with it."""

from __future__ import annotations

import contextlib
import hashlib
import json
import threading
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from nthcall import Calls, counted_requests
from objectstore import quick, serving, used
from obstore.exceptions import GenericError
from smallgraph import delivered, made, run

from fwclass.errors import FwclassError
from fwclass.operate.history import past_runs
from fwclass.operate.status.verify import verify
from fwclass.store.bucket import Remote, unit_of
from fwclass.store.objects import Objects
from fwclass.store.run_location import open_store
from fwclass.store.run_store import Store
from fwclass.store.url import Url

pytestmark = pytest.mark.faults

SAMPLE = 8
"""Requests of each kind that the default suite takes, spread over all."""

PARAMS = quick(patience=0.0, beat=0.02, dead=0.06, parallel=4)


def refuses(name: str, do: Callable[[], Any]) -> Any:
    raise GenericError("connection reset")


def loses_its_answer(name: str, do: Callable[[], Any]) -> Any:
    do()
    raise GenericError("connection reset")


def lose_one(name: str, do: Callable[[], Any], done: list[int]) -> Any:
    """The first is done; none is answered."""
    if not done:
        done.append(1)
        do()
    raise GenericError("connection reset")


KINDS = ("fails", "lost", "away", "lost and away")


def struck(n: int, kind: str) -> Calls:
    """Requests of which the n-th is struck; with the network away all that follow fail."""
    if kind in ("fails", "lost"):
        return Calls(Path("/nowhere"), n, refuses if kind == "fails" else loses_its_answer)
    done = [1] if kind == "away" else []
    return Calls(Path("/nowhere"), n, lambda name, do: lose_one(name, do, done), stays=True)


@dataclass(frozen=True)
class Case:
    """A run over `parts` with `text`, begun with the objects `before`; `clean`: what it delivers, and its parts."""

    source: Path
    place: Callable[[], Url]
    before: dict[str, bytes]
    parts: str
    text: str
    clean: tuple[dict, dict]

    def begun(self) -> Remote:
        location = Remote(self.place(), PARAMS)
        for key, data in self.before.items():
            location.objects.put(key, data)
        return location

    def run(self, location: Remote) -> list[str]:
        return run(location, self.source, self.parts, self.text)

    def check(self, location: Remote) -> None:
        """The same again, undisturbed: all is there, and nothing else."""
        assert self.run(location) == []
        there = everything(location.objects)
        address = json.loads(there["current.json"])["address"]
        shown = {
            k[len(address) + 1 :]: hashlib.sha256(d).hexdigest() for k, d in there.items() if k.startswith(address)
        }
        own = {n: d for n, d in shown.items() if n not in ("generation.json", "manifest.json")}
        store = open_store(location, lists=True)
        assert (own, made(store)) == self.clean
        assert verify(store).sound
        assert not [k for k in there if k.startswith(("store/staging", "store/failures"))]
        assert {k.split("/")[1] for k in there if k.startswith("generations/")} == {address.split("/")[1]}
        named = {unit_of(r) for name in store.parts() if (r := store.receipt(*name)) is not None}
        units = {"/".join(k.split("/")[:4]) for k in there if k.startswith("store/") and k.count("/") > 3}
        assert units == named
        assert "done" in [r["word"] for r in past_runs(location)]  # two may have begun in one second


def everything(objects: Objects) -> dict[str, bytes]:
    keys = [held.key for held in objects.list()]
    return {key: data[0] for key, data in zip(keys, objects.many(keys), strict=True) if data is not None}


def untorn(location: Remote) -> None:
    """What readers see at this moment, if anything, is all of one generation."""
    there = everything(location.objects)
    if "current.json" in there:
        below = json.loads(there["current.json"])["address"]
        for name, facts in json.loads(there[f"{below}/manifest.json"])["files"].items():
            assert hashlib.blake2b(there[f"{below}/{name}"], digest_size=16).hexdigest() == facts["digest"], name


@pytest.fixture(scope="module")
def patient() -> Iterator[None]:
    """No waiting between tries, and no beats, which would be requests at any moment."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fwclass.store.objects.time.sleep", lambda seconds: threading.Event().wait(min(seconds, 0.005)))
        patch.setattr("fwclass.store.remote_lock.Heartbeat._renew", lambda self: self._end.wait())
        yield


@pytest.fixture(scope="module", params=["memory", pytest.param("server", marks=pytest.mark.slow)])
def place(request, tmp_path_factory, patient) -> Iterator[Callable[[], Url]]:
    """A fresh one, in this process or on an S3 server."""
    copies = tmp_path_factory.mktemp("copies")
    with contextlib.ExitStack() as stack, pytest.MonkeyPatch.context() as patch:
        if request.param == "server":
            server = stack.enter_context(serving())
            for name, value in used(server, copies).items():
                patch.setenv(name, value)
            yield server.url
        else:
            patch.setenv("FWCLASS_SCRATCH", str(copies))
            yield lambda: Url(f"memory://{uuid.uuid4().hex}")


@pytest.fixture(scope="module", params=["first", "second"])
def case(request, tmp_path_factory, place) -> Case:
    base = tmp_path_factory.mktemp("nth")
    source, clean, before = base / "a.las", base / "clean", {}
    source.write_bytes(b"x" * 100)
    wanted = ("ab", "one") if request.param == "first" else ("ac", "two")
    if request.param == "second":
        location = Remote(place(), PARAMS)
        assert run(location, source, "ab", "one") == []
        before = everything(location.objects)
    assert run(clean, source, *wanted) == []
    return Case(source, place, before, *wanted, (delivered(clean), made(Store(clean))))


@pytest.mark.parametrize("how", ["some", pytest.param("all", marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_a_request_that_fails_harms_nothing(case, kind, how):
    location = case.begun()
    with counted_requests(Calls(Path("/nowhere"))) as calls:
        assert case.run(location) == []
    case.check(location)
    total = len(calls.names)
    assert total > 80 and set(calls.names) == {"get", "put", "list", "delete", "copy"}, total
    for n in range(total) if how == "all" else sorted({k * total // SAMPLE for k in range(SAMPLE)}):
        location = case.begun()
        with counted_requests(struck(n, kind)) as calls:
            try:
                failed = case.run(location)
            except FwclassError as fault:
                failed = [str(fault)]
        try:
            assert kind not in ("fails", "lost") or not failed, failed  # it was asked again
            untorn(location)
            case.check(location)
        except BaseException as fault:
            fault.add_note(f"{kind} at request {n} of {total}: {calls.names[max(0, n - 3) : n + 2]}")
            raise
