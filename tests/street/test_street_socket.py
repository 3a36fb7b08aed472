"""Who connects to `fwclass street run tcp://…` and means harm: streams end in words, sound frames are answered."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time

import pytest
from streetmaker import config, directory, drive

from fwclass.errors import InputError
from fwclass.single_file.street import online
from fwclass.street.answers import ANSWERS, read_answers
from fwclass.street.stream import HEAD, MAGIC, Decoder, encode_frame

STALL = 1.0


def served(tmp_path, send, **changed):
    """What the run told, or the fault that it ended in, with the number of frames that were answered; `send` is given a
    connection and what was said."""
    said, ended = [], []

    def client():
        until = time.monotonic() + 60
        while not any(line.startswith("listening") for line in said) and time.monotonic() < until:
            time.sleep(0.02)
        port = int(next(line for line in said if line.startswith("listening")).rsplit(":", 1)[1])
        with socket.create_connection(("127.0.0.1", port)) as there, contextlib.suppress(OSError):
            send(there, said)

    thread = threading.Thread(target=client)
    thread.start()
    asked = online.Run("tcp://:0", directory() / "model", tmp_path / "o", False, False)
    changed = {"stream.stall": STALL, **changed}
    try:
        ended.append(online.run(asked, config(*(f"street.{k}={v}" for k, v in changed.items())).street, said.append))
    except InputError as fault:
        ended.append(fault)
    finally:
        thread.join()
    there = tmp_path / "o" / ANSWERS
    return ended[0], len(list(read_answers(there))) if there.stat().st_size else 0


def head(beams, time=0.0):
    return HEAD.pack(MAGIC, beams, 0, time, 1.0, 0.0, 0.0, 0.1, 0.0, 30.0, 0)


def endlessly(there, data):
    """Send until the other side has enough."""
    until = time.monotonic() + 60
    while time.monotonic() < until:
        there.sendall(data)
        time.sleep(0.01)


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(b"GET / HTTP/1.1\r\n\r\n", id="http"),
        pytest.param(head((1 << 32) - 1), id="2^32 beams", marks=pytest.mark.slow),
        pytest.param(head(4096), id="heads without ranges"),
        pytest.param(MAGIC, id="magic", marks=pytest.mark.slow),
        pytest.param(b"\0", id="zeros", marks=pytest.mark.slow),
    ],
)
def test_who_sends_no_frame_without_end_has_stalled(tmp_path, data):
    def send(there, _):
        for frame in drive()[:5]:
            there.sendall(encode_frame(frame))
        endlessly(there, data)

    fault, answered = served(tmp_path, send)
    assert isinstance(fault, InputError) and "no frame came for 1 s" in str(fault) and "5 frames before" in str(fault)
    assert answered == 5


def test_half_a_frame_byte_by_byte_has_stalled(tmp_path):
    def send(there, _):
        data = encode_frame(drive()[0])
        for k in range(len(data)):
            there.sendall(data[k : k + 1])
            time.sleep(0.05)

    fault, answered = served(tmp_path, send)
    assert isinstance(fault, InputError) and "no frame came for 1 s" in str(fault) and answered == 0


def test_many_who_connect_do_not_disturb_the_first(tmp_path):
    refused = []

    def send(there, said):
        there.sendall(encode_frame(drive()[0]))
        while not any(line.startswith("connected") for line in said):
            time.sleep(0.01)
        port = there.getpeername()[1]
        for _ in range(300):
            try:
                socket.create_connection(("127.0.0.1", port), 5).close()
            except OSError:
                refused.append(port)
        for frame in drive()[1:40]:
            there.sendall(encode_frame(frame))

    told, answered = served(tmp_path, send, **{"stream.stall": 20.0})
    assert told["frames"] == answered == 40 and len(refused) == 300


def test_a_connection_that_is_reset_leaves_whole_answers(tmp_path):
    def send(there, _):
        for frame in drive()[:20]:
            there.sendall(encode_frame(frame))
        time.sleep(1.0)
        there.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))

    told, answered = served(tmp_path, send, **{"stream.stall": 20.0})
    assert told["frames"] == answered == 20 and told["stream"] == {"broken connection": 1}


def test_the_work_for_heads_in_each_other_is_bounded_by_their_bytes():
    """Every 12 bytes begin another frame of the most beams, whose sum is then wrong; sums are counted, not seconds."""
    most, pattern = 4096, MAGIC + struct.pack("<If", 4096, 0.0)
    decoder, data = Decoder(most), pattern * 20_000
    for at in range(0, len(data), 1 << 16):
        assert list(decoder.feed(data[at : at + (1 << 16)])) == []
        assert len(decoder._held) <= HEAD.size + 4 * most + (1 << 16)
    decoder.end()
    assert 0 < decoder.faults["bad sum"] <= len(data) / len(pattern)
