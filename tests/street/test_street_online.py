"""On-line and whole: the same bytes; what is emitted stays; streams that misbehave."""

import contextlib
import errno
import json
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from dataclasses import replace
from io import FileIO

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from streetmaker import config, directory, drive

from fwclass import conf
from fwclass.cli.runner import open_runner
from fwclass.errors import ConfigError, FwclassError, InputError
from fwclass.single_file.street import batch, online
from fwclass.single_file.street.output import working_in
from fwclass.street.answers import ANSWERS, read_answers
from fwclass.street.frames import Frame, Scan
from fwclass.street.recording_parquet import write_recording
from fwclass.street.stream import HEAD, MAGIC, Decoder, encode_frame
from fwclass.street.track import WANDER, Track


def run_online(tmp_path, source=None, name="on", **changed):
    asked = online.Run(
        str(source or directory() / "drive.parquet"), directory() / "model", tmp_path / name, False, False
    )
    params = config(*(f"street.{k}={v}" for k, v in changed.items())).street
    return online.run(asked, params, print), tmp_path / name


def run_batch(tmp_path, workers, name, source=None, **changed):
    made = config(*(f"street.{k}={v}" for k, v in changed.items()))
    (tmp_path / name).mkdir()
    with open_runner(tmp_path / f".{name}", workers, None, made.run) as runner:
        work = batch.Work(source or directory() / "drive.parquet", directory() / "model", made.street)
        return batch.classify(work, tmp_path / name, runner, made), tmp_path / name


@pytest.fixture(scope="module")
def once(tmp_path_factory):
    return run_online(tmp_path_factory.mktemp("street"))


OUTPUTS = (ANSWERS, "prescription.csv", "prescription.parquet", "prescription.png")


def test_online_and_whole_give_the_same_bytes(tmp_path, once):
    told, there = once
    assert told["latency"]["frames"] > 100
    for workers, chunk in ((0, 400), (0, 37)):
        made, other = run_batch(tmp_path, workers, f"w{workers}-{chunk}", chunk=chunk)
        assert made["accuracy"]["detection"] > 0.9
        for name in OUTPUTS:
            assert (there / name).read_bytes() == (other / name).read_bytes(), (name, chunk)


def test_online_and_whole_give_the_same_bytes_of_a_turned_scanner(tmp_path):
    turned = {"mounting.yaw": 12, "mounting.pitch": -5}
    told, there = run_online(tmp_path, **turned)
    made, other = run_batch(tmp_path, 0, "turned", chunk=37, **turned)
    for name in OUTPUTS:
        assert (there / name).read_bytes() == (other / name).read_bytes(), name
    answers = list(read_answers(there / ANSWERS))
    assert all(len(a.x) == len(a.y) for a in answers)
    assert told["segments"] == made["segments"] > 5


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_workers_give_the_same_bytes(tmp_path, once, workers):
    _, other = run_batch(tmp_path, workers, "many", chunk=50)
    assert (once[1] / ANSWERS).read_bytes() == (other / ANSWERS).read_bytes()


def test_every_frame_is_answered_in_order_but_those_of_a_stop(once):
    answers = {a.number: a for a in read_answers(once[1] / ANSWERS)}
    passed_over = [f for f in drive() if f.number not in answers]
    assert list(answers) == [f.number for f in drive() if f.number in answers]
    assert len(passed_over) == once[0]["faults"]["hardly moved"] > 10
    assert all(f.speed == 0.0 for f in passed_over)
    for frame in drive():
        if frame.number in answers:
            one = answers[frame.number]
            assert np.array_equal(one.classification > 0, ~np.isnan(one.y))
            assert (one.classification > 0).sum() <= np.isfinite(frame.ranges).sum()


def standing_drive(place, seconds):
    """The drive, with a stand of `seconds` at one of its frames."""
    more = round(seconds / 0.025)
    frames = [replace(f, time=f.time + 0.025 * more * (f.number > place)) for f in drive()]
    there = frames[place]
    stand = (replace(there, number=1000 + k, time=there.time + 0.025 * (k + 1), speed=0.0) for k in range(more))
    return [*frames[: place + 1], *stand, *frames[place + 1 :]]


def test_crowns_are_found_beside_a_vehicle_that_stands_for_long(tmp_path):
    """Copies of one frame would outweigh those around it."""
    place = next(k for k in range(120, 30, -1) if all(f.speed > 0 for f in drive()[k - 30 : k + 6]))
    here = {f.number: f.labels == 5 for f in drive()[place - 5 : place + 6]}
    answered = []
    for seconds in (2, 20):
        path = tmp_path / f"{seconds}.parquet"
        write_recording(path, standing_drive(place, seconds))
        told, out = run_online(tmp_path, path, f"on-{seconds}")
        answered.append(list(read_answers(out / ANSWERS)))
        assert told["faults"]["hardly moved"] == told["frames"] - len(answered[-1]) > 40 * seconds - 20
        found = [(a.classification[here[a.number]] == 5).mean() for a in answered[-1] if a.number in here]
        assert len(found) == len(here) and np.mean(found) > 0.9, found
        made, whole = run_batch(tmp_path, 0, f"whole-{seconds}", path, chunk=37)
        assert (out / ANSWERS).read_bytes() == (whole / ANSWERS).read_bytes()
        assert made["faults"] == told["faults"]
    assert all(np.array_equal(a.classification, b.classification) for a, b in zip(*answered, strict=True))


def kept_places(places):
    """Of frames at `places` [m], those that are taken into spheres and answered."""
    track = Track(conf.section("street").model_copy(update={"speed": 1.0}))
    scan = Scan(3, -0.1, 0.1, 0.05, 30.0)
    frames = (Frame(k, 0.025 * k, scan, np.full(3, 2.0, np.float32), place=p) for k, p in enumerate(places))
    taken = ((f.place, track.take(f)) for f in frames)
    return np.array([place for place, one in taken if one is not None and not one.repeats])


@pytest.mark.statistics
def test_a_vehicle_that_creeps_is_taken_as_one_that_drives_slowly():
    for speed in (0.3, 0.05, 0.002):
        places = np.arange(0.0, 2.0, speed * 0.025)
        kept = kept_places(places)
        assert len(kept) == pytest.approx(6 + 2.0 / 0.0125, abs=2)
        late = np.diff(kept[kept > kept[6] + 0.1])
        assert late.max() <= 0.0126 + speed * 0.025
    assert len(kept_places(np.arange(0.0, 2.0, 0.0126))) == 159  # half a metre a second, and above: all


@pytest.mark.statistics
@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_places_that_wander_while_the_vehicle_stands_are_no_way(noise):
    """Its frames were taken for as long as it stood, and nearly all returns around became crown."""
    random = np.random.default_rng(3)
    stand = 5.0 + noise * random.normal(size=4000)
    kept = kept_places([*np.arange(0.0, 5.0, 0.025), *stand, *np.arange(5.0, 10.0, 0.025)])
    assert len(kept) < 400 + 6 + WANDER / 0.0125
    assert (kept < 4.5).sum() == 180 and (kept > 5.5).sum() >= 179  # elsewhere nothing is lost


def test_a_vehicle_that_goes_back_is_taken_after_the_road_that_wanders():
    kept = kept_places([*np.arange(0.0, 3.0, 0.025), *np.arange(3.0, 0.0, -0.025)])
    assert 240 - 10 < len(kept) <= 240


def test_answers_that_were_cut_are_read_up_to_the_last_whole_frame(tmp_path, once):
    data, whole = (once[1] / ANSWERS).read_bytes(), [a.number for a in read_answers(once[1] / ANSWERS)]
    for cut in (len(data) - 9, len(data) // 2, len(data) // 3 + 7):
        (tmp_path / "cut").write_bytes(data[:cut])
        got = [a.number for a in read_answers(tmp_path / "cut")]
        assert got == whole[: len(got)]
        assert len(got) >= cut // (len(data) // len(whole)) - 2
    (tmp_path / "other").write_bytes(b"nothing of the kind")
    with pytest.raises(InputError, match="no file of answers"):
        list(read_answers(tmp_path / "other"))


@settings(max_examples=40, deadline=None)
@given(st.lists(st.one_of(st.integers(0, 9), st.binary(max_size=300)), max_size=12), st.integers(1, 5000))
def test_a_stream_with_garbage_gives_the_frames_that_are_whole(pieces, size):
    data = b"".join(encode_frame(drive()[p]) if isinstance(p, int) else p for p in pieces)
    wanted = [p for p in pieces if isinstance(p, int)]
    decoder = Decoder(2000)
    got = [f.number for at in range(0, len(data), size) for f in decoder.feed(data[at : at + size])]
    decoder.end()
    if not any(isinstance(p, bytes) and MAGIC[:1] in p for p in pieces):
        assert got == wanted
    assert set(got) <= set(wanted)


def test_frames_with_a_flipped_bit_or_impossible_sizes_are_passed_over():
    decoder = Decoder(2000)
    good, bad = encode_frame(drive()[0]), bytearray(encode_frame(drive()[1]))
    bad[500] ^= 4
    huge = HEAD.pack(MAGIC, 1 << 31, 0, 0.0, 1.0, 0.0, 0.0, 0.1, 0.0, 1.0, 0)
    got = list(decoder.feed(good + bytes(bad) + huge + good))
    assert [f.number for f in got] == [0, 0]
    assert decoder.faults["bad sum"] == 1
    assert decoder.faults["impossible frame"] == 1


def connect(told, source_port=None):
    for _ in range(600):
        for line in list(told):
            if line.startswith("listening"):
                return socket.create_connection(("127.0.0.1", int(line.rsplit(":", 1)[1])))
        time.sleep(0.05)
    raise AssertionError(told)


def served(tmp_path, send, name="tcp", **changed):
    told, ended = [], []

    def client():
        with connect(told) as there:
            send(there)

    thread = threading.Thread(target=client)
    asked = online.Run("tcp://:0", directory() / "model", tmp_path / name, False, False)
    params = config(*(f"street.{k}={v}" for k, v in changed.items())).street
    thread.start()
    try:
        ended.append(online.run(asked, params, told.append))
    finally:
        thread.join()
    return ended[0], tmp_path / name


def test_a_socket_gives_what_the_recording_gives(tmp_path, once):
    def send(there):
        for frame in drive():
            there.sendall(encode_frame(frame))

    told, out = served(tmp_path, send)
    assert told["frames"] == len(drive())
    # speeds are doubles, ranges floats in both: nothing is lost on the way
    assert (out / ANSWERS).read_bytes() == (once[1] / ANSWERS).read_bytes()


def test_a_sender_that_breaks_off_within_a_frame(tmp_path):
    def send(there):
        for frame in drive()[:60]:
            there.sendall(encode_frame(frame))
        there.sendall(encode_frame(drive()[60])[:700])

    told, out = served(tmp_path, send)
    assert told["stream"] == {"cut frame": 1}
    assert len(list(read_answers(out / ANSWERS))) == 60


def test_a_sender_that_falls_silent(tmp_path):
    def send(there):
        for frame in drive()[:30]:
            there.sendall(encode_frame(frame))
        with contextlib.suppress(OSError):
            there.recv(1)

    with pytest.raises(InputError, match="no frame came for 1 s"):
        served(tmp_path, send, name="silent", **{"stream.stall": 1.0})
    assert len(list(read_answers(tmp_path / "silent" / ANSWERS))) == 30


def test_nothing_but_garbage(tmp_path):
    with pytest.raises(InputError, match="not one frame came"):
        served(tmp_path, lambda there: there.sendall(b"GET / HTTP/1.1\r\n\r\n" * 100), name="http")


def test_an_address_that_is_none(tmp_path):
    with pytest.raises(ConfigError, match="no address"):
        run_online(tmp_path, "tcp://localhost")
    with pytest.raises(ConfigError, match="no user") as fault:
        run_online(tmp_path, "tcp://me:secret@localhost:5000")
    assert "secret" not in str(fault.value)


def command(*words):
    return [sys.executable, "-m", "fwclass", "street", *map(str, words)]


@pytest.mark.slow
def test_a_kill_leaves_whole_frames_and_an_interrupt_ends_cleanly(tmp_path, once):
    whole = [a.number for a in read_answers(once[1] / ANSWERS)]
    for sent, code in ((signal.SIGKILL, -signal.SIGKILL), (signal.SIGINT, 130)):
        out = tmp_path / sent.name
        words = command("run", "-", "--model", directory() / "model", "--out", out)
        with subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path) as child:
            for frame in drive()[:80]:
                child.stdin.write(encode_frame(frame))
            child.stdin.flush()
            until = time.monotonic() + 120
            while time.monotonic() < until and (
                not (out / ANSWERS).exists() or (out / ANSWERS).stat().st_size < 400_000
            ):
                time.sleep(0.05)
            child.send_signal(sent)
            child.stdin.close()
            child.wait(60)
            assert child.returncode == code
        got = [a.number for a in read_answers(out / ANSWERS)]
        assert got == whole[: len(got)]
        assert len(got) >= 30
        assert (out / "summary.json").exists() == (sent == signal.SIGINT)


@pytest.mark.slow
def test_standard_input_by_the_command_line(tmp_path, once):
    data = b"".join(encode_frame(f) for f in drive())
    words = command("run", "-", "--model", directory() / "model", "--out", tmp_path / "o", "--json")
    done = subprocess.run([*words, "--set", "street.speed=1.5"], input=data, capture_output=True, check=True)
    assert json.loads(done.stdout)["frames"] == len(drive())
    assert (tmp_path / "o" / ANSWERS).read_bytes() == (once[1] / ANSWERS).read_bytes()


def test_an_output_is_not_overwritten(tmp_path, once):
    with pytest.raises(ConfigError, match="output already"):
        working_in(once[1], False).__enter__()
    (tmp_path / "mine").write_text("x")
    with pytest.raises(ConfigError, match="something else"):
        working_in(tmp_path, True).__enter__()


def test_what_does_not_fit_on_the_disk_is_not_there_in_part(tmp_path):
    class Full(FileIO):
        def write(self, data):
            if (room := min(len(data), 10, 30 - self.tell())) <= 0:
                raise OSError(errno.ENOSPC, "No space left on device")
            return super().write(data[:room])

    with Full(tmp_path / "a", "wb") as file:
        online.append(file, b"a" * 25)
        with pytest.raises(FwclassError, match="No space left on device"):
            online.append(file, b"b" * 20)
    assert (tmp_path / "a").read_bytes() == b"a" * 25


def test_what_a_killed_command_has_left_is_swept(tmp_path):
    """A file that was not whole yet was something else, beside which nothing may be written."""
    dies = "import os, pathlib, sys; from fwclass.publish.files import written_whole\n"
    dies += "with written_whole(pathlib.Path(sys.argv[1])) as beside: beside.touch(); os._exit(9)"
    subprocess.run([sys.executable, "-c", dies, tmp_path / "o" / "summary.json"], check=False)
    assert len(list((tmp_path / "o").iterdir())) == 1
    with working_in(tmp_path / "o", True):
        assert not any((tmp_path / "o").iterdir())


def test_two_commands_do_not_write_to_one_directory(tmp_path):
    with working_in(tmp_path / "o", False):
        for overwrite in (False, True):
            with pytest.raises(ConfigError, match="another command is writing"):
                working_in(tmp_path / "o", overwrite).__enter__()
        (tmp_path / "o" / ANSWERS).write_bytes(b"1")
    with working_in(tmp_path / "o", True):
        assert not any((tmp_path / "o").iterdir())


def test_a_model_of_airborne_features_is_refused(tmp_path):
    from fwclass.graph.street import params_of
    from fwclass.model import Forest

    card = {"features": ["zc", "amplitude"], "computed": {}}
    model = Forest(*(np.zeros(0) for _ in range(4)), card=card)
    with pytest.raises(ConfigError, match="features of frames"):
        params_of(model, config().street, "there")


def test_the_protocol_is_what_its_description_says():
    frame = drive()[3]
    data = encode_frame(frame)
    assert len(data) == 68 + 4 * 1081
    assert struct.unpack_from("<4sIQd", data) == (b"FWS1", 1081, 3, frame.time)
    assert data[68:] == frame.ranges.tobytes()


def test_memory_of_the_loop_does_not_grow():
    import tracemalloc

    from fwclass.single_file.street.online import Latency
    from fwclass.store.models import load_model

    loop = online.Loop(load_model(directory() / "model"), config().street)
    latency, held = Latency(), []
    tracemalloc.start()
    for k in range(700):
        frame = replace(drive()[k % 100], number=k, time=0.025 * k)
        for _ in loop.take(frame):
            latency.add(0.001 * (k % 7))
        if k in (300, 699):
            held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert held[1] < 1.05 * held[0]
    assert latency.summary()["frames"] > 560


def test_what_measures_the_way_is_warmed_too(monkeypatch):
    from fwclass.store.models import load_model
    from fwclass.street import way

    called = set()
    for name in ("add_upwards", "add_along", "add_leans"):
        kernel = getattr(way, name)
        monkeypatch.setattr(way, name, lambda *a, kernel=kernel, name=name: (called.add(name), kernel(*a)))
    online.warm(load_model(directory() / "model"), config().street)
    assert called == {"add_upwards", "add_along", "add_leans"}
