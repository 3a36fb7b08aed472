"""Where frames come from as they come: a recording at its pace, standard input, a socket."""

from __future__ import annotations

import os
import queue
import selectors
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from fwclass.errors import ConfigError, InputError
from fwclass.street.frames import Frame, Recording
from fwclass.street.params import StreamParams
from fwclass.street.stream import Decoder

PIECE = 1 << 16
"""Bytes that are read at a time."""

GLANCE = 0.2
"""s, after which a waiting reader looks whether it is to end."""

Timed = tuple[Frame, float]
"""A frame and when it was there, by `time.perf_counter`."""


def from_recording(recording: Recording, paced: bool, ended: Callable[[], bool]) -> Iterator[Timed]:
    """Frames of a recording, each not before its time if `paced`."""
    began, first = time.perf_counter(), None
    for frame in recording.frames():
        if ended():
            return
        first = frame.time if first is None else first
        if paced:
            due = began + frame.time - first
            while (wait := due - time.perf_counter()) > 0:
                if ended():
                    return
                time.sleep(min(wait, GLANCE))
        yield frame, time.perf_counter()


class Stream:
    """Frames of a stream of bytes, read by a thread of its own; what waits is bounded, the oldest is dropped.

    Bytes that are no frame are silence: who sends nothing else for `stall` seconds has stalled.
    """

    def __init__(self, read: Callable[[], bytes | None], params: StreamParams, ended: Callable[[], bool]) -> None:
        """`read`: some bytes, b"" at the end, None if there are none for now."""
        self.params, self.faults = params, Counter[str]()
        self.stalled = False
        self._read, self._ended = read, ended
        self._decoder = Decoder(params.most_beams)
        self._waiting: queue.Queue[Timed | None] = queue.Queue()
        self._thread = threading.Thread(target=self._work, daemon=True)

    def frames(self) -> Iterator[Timed]:
        """Frames as they come, until the stream ends, stalls or is interrupted."""
        self._thread.start()
        while not self._ended():
            try:
                one = self._waiting.get(timeout=GLANCE)
            except queue.Empty:
                continue
            if one is None:
                break
            yield one
        self.faults.update(self._decoder.faults)

    def _work(self) -> None:
        heard = time.monotonic()
        while not self._ended():
            try:
                data = self._read()
            except OSError:
                self.faults["broken connection"] += 1
                break
            if data == b"":
                break
            for frame in self._decoder.feed(data or b""):
                heard = time.monotonic()
                self._put((frame, time.perf_counter()))
            if time.monotonic() - heard > self.params.stall:
                self.stalled = True
                break
        self._decoder.end()
        self._waiting.put(None)

    def _put(self, one: Timed) -> None:
        while self._waiting.qsize() >= self.params.queue:
            try:
                self._waiting.get_nowait()
                self.faults["dropped"] += 1
            except queue.Empty:
                break
        self._waiting.put(one)


def standard_input(params: StreamParams, ended: Callable[[], bool]) -> Stream:
    """Frames that another program writes to this one."""
    handle = sys.stdin.fileno()
    waiting = selectors.SelectSelector()
    plain = True
    try:
        waiting.register(handle, selectors.EVENT_READ)
    except (OSError, ValueError):
        plain = False

    def read() -> bytes | None:
        if plain and not waiting.select(GLANCE):
            return None
        return os.read(handle, PIECE)

    return Stream(read, params, ended)


def place_of(address: str) -> tuple[str, int]:
    """Host and port of ``tcp://host:port``; without a host it is this machine's own."""
    host, mark, port = address.removeprefix("tcp://").rpartition(":")
    if "@" in host:
        raise ConfigError(
            "an address to listen at has no user",
            where="tcp://",
            expected="tcp://host:port",
            got="a user, or what may be a password",
            do="leave it out; it is not checked, and shown to whoever lists this host's processes",
        )
    if not mark or not port.isdigit() or not 0 <= int(port) < 65536:
        raise ConfigError("this is no address to listen at", where=address, expected="tcp://host:port", got=address)
    return host.strip("[]") or "127.0.0.1", int(port)


@contextmanager
def listening(
    address: str, params: StreamParams, ended: Callable[[], bool], say: Callable[[str], None]
) -> Iterator[Stream]:
    """Frames of the first who connects to `address`; who else does is turned away."""
    host, port = place_of(address)
    try:
        server = socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as fault:
        raise InputError(
            "cannot listen there", where=address, got=fault.strerror or str(fault), do="choose another port or host"
        ) from fault
    with server:
        server.settimeout(GLANCE)
        say(f"listening    tcp://{host}:{server.getsockname()[1]}")
        sockets: list[Any] = []

        def read() -> bytes | None:
            if not sockets:
                try:
                    connection, peer = server.accept()
                except TimeoutError:
                    return None
                server.close()
                connection.settimeout(GLANCE)
                sockets.append(connection)
                say(f"connected    {peer[0]}:{peer[1]}")
            try:
                return bytes(sockets[0].recv(PIECE))
            except TimeoutError:
                return None

        try:
            yield Stream(read, params, ended)
        finally:
            for connection in sockets:
                connection.close()
