"""One writer per run on object storage: an object that its holder renews.

No clock is asked: who finds the lock held watches its version, and takes it over when that has not changed for `dead`
seconds by the finder's own monotonic watch. Every write is conditional on the version read before, so only one can win.
What a holder that was thought dead still does is refused: its parts are committed only while the lock bears its token.
"""

from __future__ import annotations

import json
import os
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil

from fwclass.errors import LockedError, StoreError, visible
from fwclass.store.lock import WRITER, Lock, holder_text
from fwclass.store.objects import Mark, Objects
from fwclass.store.refusals import LostRace

_PROBE = "store/probe"


def lock_key(lock: Lock) -> str:
    """The key of a lock's object."""
    return f"store/{lock.name}"


class Heartbeat:
    """Renews the lock until it is told to end; `check` raises `LostRace` once somebody else has it."""

    def __init__(self, objects: Objects, lock: Lock, facts: Mapping[str, Any], mark: Mark) -> None:
        self._objects, self._lock, self._facts, self._mark = objects, lock, dict(facts), mark
        self._end, self._lost = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._renew, name="lock", daemon=True)
        self._thread.start()

    def check(self) -> None:
        """`LostRace` where the lock is another's by now."""
        if self._lost.is_set():
            who = self._lock.who
            raise LostRace(
                f"another {who} took this {who}'s lock over; {self._lock.then}",
                where=self._objects.url,
                got="the lock was not renewed in time: this host slept, or its network was away",
                do=f"see which other {who} works below this address; if none does, run the same again",
            )

    def _renew(self) -> None:
        beat = 0
        while not self._end.wait(self._objects.params.beat):
            beat += 1
            try:
                self._mark = self._objects.put_over(lock_key(self._lock), _data(self._facts, beat), self._mark)
            except LostRace:
                self._lost.set()
                return
            except StoreError:
                continue  # nobody can commit anything now; the next beat will tell whose the lock is

    def end(self) -> None:
        """Give the lock back."""
        self._end.set()
        self._thread.join(self._objects.params.timeout)
        if not self._lost.is_set():
            with suppress(StoreError):
                self._objects.put_over(lock_key(self._lock), b"{}", self._mark)


def _data(facts: Mapping[str, Any], beat: int) -> bytes:
    return json.dumps({**facts, "beat": beat}, sort_keys=True).encode()


@contextmanager
def remote_writer(
    objects: Objects, tell: Callable[[str], None], lock: Lock = WRITER
) -> Iterator[tuple[str, Heartbeat]]:
    """Hold the run below `objects`; a second writer gets a `LockedError` naming the first one's host and pid.

    Gives the token under which parts are committed, and what tells whether the lock is still held. A lock whose holder
    does not renew it is watched for ``params.dead`` seconds, of which `tell` says so, and then taken over.
    """
    _check_conditional(objects)
    token = uuid.uuid4().hex
    facts = {"host": socket.gethostname(), "pid": os.getpid(), "machine": _machine(), "token": token}
    beat = Heartbeat(objects, lock, facts, _take(objects, lock, _data(facts, 0), tell))
    try:
        yield token, beat
    finally:
        beat.end()


def _check_conditional(objects: Objects) -> None:
    """`StoreError` where the server takes no notice of conditions: two runs could not be kept apart there."""
    own = uuid.uuid4().hex.encode()
    objects.put(_PROBE, own)
    for mark in (None, Mark('"00000000000000000000000000000000"', "0")):
        with suppress(LostRace):
            if mark is None:
                objects.put_new(_PROBE, b"new")
            else:
                objects.put_over(_PROBE, b"over", mark)
            raise StoreError(
                "this object storage has no conditional writes",
                where=objects.url,
                expected="a write with If-None-Match or If-Match is refused where its condition does not hold",
                got="the object was written over",
                do="use a server that has them (Amazon S3, Google, Azure; MinIO and Ceph of 2024 or later)",
            )


def _take(objects: Objects, lock: Lock, data: bytes, tell: Callable[[str], None]) -> Mark:
    key = lock_key(lock)
    present = objects.get(key)
    if present is None:
        try:
            return objects.put_new(key, data)
        except LostRace:
            present = objects.get(key)
            if present is None:
                raise
    if facts := _facts(present[0]):
        present = _watch(objects, lock, facts, present, tell)
    try:
        return objects.put_over(key, data, present[1])
    except LostRace as fault:
        after = objects.get(key)
        raise _refusal(objects, lock, _facts(after[0]) if after else {}) from fault


def _watch(
    objects: Objects, lock: Lock, facts: Mapping[str, Any], stored: tuple[bytes, Mark], tell: Callable[[str], None]
) -> tuple[bytes, Mark]:
    """The lock as it is when its holder has been silent long enough; `StoreError` as soon as it shows life."""
    if facts.get("machine") == _machine() and not psutil.pid_exists(int(facts.get("pid", 0))):
        tell(f"lock         its holder, process {facts.get('pid')} of this host, is gone; it is taken over")
        return stored
    params = objects.params
    tell(
        f"lock         held by process {facts.get('pid')} of {facts.get('host')}; taken over if it is silent for "
        f"{params.dead:g} s"
    )
    began = time.monotonic()
    while time.monotonic() - began < params.dead:
        time.sleep(min(params.beat, params.dead) / 2)
        now = objects.get(lock_key(lock))
        if now is None or now[1] != stored[1]:
            if now is not None and not _facts(now[0]):
                return now  # it ended just now
            raise _refusal(objects, lock, facts)
    return stored


def _refusal(objects: Objects, lock: Lock, facts: Mapping[str, Any]) -> LockedError:
    return LockedError(lock.refusal, where=objects.url, got=holder_text(facts), do=lock.do)


def check_token(objects: Objects, token: str, lock: Lock = WRITER) -> None:
    """`LostRace` where the lock does not bear `token` any more: who slept does not write over who followed."""
    present = objects.get(lock_key(lock))
    if present is None or _facts(present[0]).get("token") != token:
        raise LostRace(
            f"this {lock.who} has lost its lock; {lock.then}",
            where=objects.url,
            got=present[0].decode(errors="replace") if present else "no lock",
            do=f"see which other {lock.who} works below this address",
        )


def remote_holder(objects: Objects, lock: Lock = WRITER) -> Mapping[str, Any] | None:
    """Host and pid of the run that holds the lock, None where there is none; one that was killed is told too, until
    somebody waits for it."""
    present = objects.get(lock_key(lock))
    facts = _facts(present[0]) if present else {}
    if not facts or (facts.get("machine") == _machine() and not psutil.pid_exists(int(facts.get("pid", 0)))):
        return None
    return {n: visible(v) if isinstance(v, str) else v for n, v in facts.items() if n in ("host", "pid")}


def _facts(data: bytes) -> dict[str, Any]:
    """What a lock says of its holder, empty for one that nobody holds."""
    try:
        facts = json.loads(data)
    except (json.JSONDecodeError, UnicodeDecodeError):
        return {}
    return facts if isinstance(facts, dict) else {}


def _machine() -> str:
    """The same for two processes only if each sees the other's pid: this run of the host, and the space of pids."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"  # noqa: PTH115 - it is no path
    except OSError:
        return uuid.uuid4().hex
