"""Webhook and command, with a real server and real processes: what is sent, what is tried again, what is never told."""

from __future__ import annotations

import base64
import contextlib
import json
import socket
import sys
import threading
import time

import pytest
from hook import Hook

from fwclass import conf
from fwclass.operate.schedule.child import Signals
from fwclass.operate.schedule.notify import command, longest, post, tell_within

HIDDEN = "Xy7HIDDENz"
RECORD = {"id": "1", "word": "done", "exit_code": 0, "why": {"trigger": "cron"}, "run": "/r"}


TOKEN = {"webhook_token_env": "HOOK_TOKEN"}


def params(**change):
    base = {"webhook_pause": 0.05, "webhook_timeout": 1.0, "look": 0.1}
    return conf.section("schedule", change={"schedule": {**base, **change}})


def never() -> bool:
    return False


def test_the_record_is_posted_with_the_token(monkeypatch):
    monkeypatch.setenv("HOOK_TOKEN", HIDDEN)
    with Hook() as hook:
        address = f"http://{hook.place}/{HIDDEN}?key={HIDDEN}#x"
        told = post(params(webhook=address, **TOKEN), RECORD, never)
    [(path, headers, body)] = hook.got
    assert told.as_data() == {"to": f"http://{hook.place}/…", "ok": True, "fault": "", "tries": 1}
    assert path == f"/{HIDDEN}?key={HIDDEN}" and json.loads(body) == RECORD
    assert headers["Authorization"] == f"Bearer {HIDDEN}" and headers["Content-Type"] == "application/json"


def test_a_user_in_the_address_goes_into_the_header():
    with Hook() as hook:
        told = post(params(webhook=f"http://me:a%40{HIDDEN}@{hook.place}/x"), RECORD, never)
    [(path, headers, _)] = hook.got
    assert path == "/x" and headers["Host"] == hook.place and HIDDEN not in told.address
    assert headers["Authorization"] == "Basic " + base64.b64encode(f"me:a@{HIDDEN}".encode()).decode()


@pytest.mark.parametrize(
    ("answers", "tries", "fault"),
    [
        (["hang up", 503], 3, ""),
        ([429, 500, 502], 3, "answered 502"),
        ([404], 1, "answered 404"),
        ([401], 1, "answered 401"),
        (["silent"], 2, ""),
        (["hang up"] * 3, 3, "RemoteDisconnected"),
    ],
)
def test_what_may_pass_is_tried_again(answers, tries, fault):
    with Hook(list(answers)) as hook:
        told = post(params(webhook=f"http://{hook.place}/{HIDDEN}"), RECORD, never)
    assert (told.tries, told.fault) == (tries, fault) and len(hook.got) == tries
    assert HIDDEN not in str(told)


def _dripped(there, head):
    there.sendall(head)
    while True:
        there.sendall(b"x")
        time.sleep(0.05)


def _put_off(there):
    while True:
        there.sendall(b"HTTP/1.1 100 Continue\r\n\r\n" * 100)


ENDLESS = {
    "a body letter by letter": (lambda t: _dripped(t, b"HTTP/1.1 200 OK\r\nContent-Length: 100000\r\n\r\n"), ""),
    "heads letter by letter": (lambda t: _dripped(t, b"HTTP/1.1 "), "no answer in time"),
    "put off for ever": (_put_off, "no answer in time"),
}


@pytest.mark.parametrize("kind", ENDLESS)
def test_an_answer_without_end_holds_nobody_up(kind):
    """A thread went on with it as long as the service did, of a schedule that runs for months."""
    answer, fault = ENDLESS[kind]

    def serve():
        there, _ = listening.accept()
        with there, contextlib.suppress(OSError):
            there.recv(65_536)
            answer(there)

    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=serve, daemon=True).start()
        address = f"http://127.0.0.1:{listening.getsockname()[1]}/x"
        told: list = []
        words = params(webhook=address, webhook_timeout=0.2, webhook_tries=1)
        asking = threading.Thread(target=lambda: told.append(post(words, RECORD, never)), daemon=True)
        asking.start()
        asking.join(30)
    assert [t.fault for t in told] == [fault]


@pytest.mark.parametrize("kind", [301, 302, 303, 307, 308])
def test_no_redirection_is_followed(monkeypatch, kind):
    monkeypatch.setenv("HOOK_TOKEN", HIDDEN)
    with Hook() as other, Hook() as hook:
        hook.answers.append(kind if kind != 302 else f"http://{other.place}/{HIDDEN}")
        told = post(params(webhook=f"http://{hook.place}/x", **TOKEN), RECORD, never)
    assert len(hook.got) == 1 and not other.got
    assert f"answered {kind}: it redirects, which is not followed" in told.fault and HIDDEN not in str(told)


def test_no_one_at_home():
    with Hook() as gone:
        place = gone.place
    told = post(params(webhook=f"http://{place}/{HIDDEN}"), RECORD, never)
    assert told.fault == "ConnectionRefusedError: Connection refused" and told.tries == 3 and HIDDEN not in str(told)
    told = post(params(webhook=f"https://no.invalid/{HIDDEN}", webhook_tries=1), RECORD, never)
    assert told.fault.startswith("gaierror") and HIDDEN not in str(told)
    told = post(params(webhook=f"http://{place}/{HIDDEN}", **{"webhook_token_env": "NO_SUCH_THING"}), RECORD, never)
    assert "NO_SUCH_THING is not set" in told.fault and told.tries == 0


def test_an_unencrypted_port_is_told_in_words():
    with Hook() as hook:
        told = post(params(webhook=f"https://{hook.place}/{HIDDEN}", webhook_tries=1), RECORD, never)
    assert "SSL" in told.fault and HIDDEN not in str(told) and not hook.got


def test_a_stop_ends_the_tries():
    with Hook([503] * 9) as hook:
        told = post(params(webhook=f"http://{hook.place}/", webhook_tries=9, webhook_pause=30.0), RECORD, lambda: True)
    assert told.tries == 1 and len(hook.got) == 1


def test_signals_and_the_status_do_not_wait_for_a_slow_service():
    beats = []
    with Hook(["silent"]) as hook, Signals() as signals:
        asked = params(webhook=f"http://{hook.place}/", webhook_timeout=20.0)
        signals.count = 2
        told = tell_within(asked, RECORD, signals, lambda: beats.append(1))
        assert told["webhook"]["fault"] == "given up"
    with Hook() as hook, Signals() as signals:
        told = tell_within(params(webhook=f"http://{hook.place}/"), RECORD, signals, lambda: beats.append(1))
    assert told["webhook"]["ok"] and longest(asked) > 3 * 20.0
    assert tell_within(params(), RECORD, Signals(), never) == {}


def test_a_command_gets_record_and_key_facts(tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("HOOK_TOKEN", HIDDEN)
    monkeypatch.delenv("FWCLASS_DATA", raising=False)
    script = (
        "import json, os, sys; r = json.load(sys.stdin); print('printed');"
        f"json.dump([r, dict(os.environ)], open({str(tmp_path / 'got')!r}, 'w')); sys.exit(5)"
    )
    told = command(params(command=[sys.executable, "-c", script], **TOKEN), RECORD)
    record, environment = json.loads((tmp_path / "got").read_text())
    assert record == RECORD and told.fault == "exit code 5" and told.address.startswith("python")
    facts = {k: v for k, v in environment.items() if k.startswith("FWCLASS_")}
    assert facts == {
        "FWCLASS_RUN": "/r",
        "FWCLASS_WORD": "done",
        "FWCLASS_ID": "1",
        "FWCLASS_EXIT_CODE": "0",
        "FWCLASS_TRIGGER": "cron",
    }
    assert "HOOK_TOKEN" not in environment
    out, err = capfd.readouterr()
    assert out == "" and "printed" in err


def test_a_command_that_hangs_or_is_not_there(tmp_path):
    hangs = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'import time; time.sleep(600)'])"
    told = command(params(command=[sys.executable, "-c", hangs], command_timeout=0.5), RECORD)
    assert told.fault == "it took longer than 0.5 s and was ended"
    assert "could not be started" in command(params(command=[str(tmp_path / "none"), HIDDEN]), RECORD).fault
    assert command(params(command=["true"]), RECORD).fault == ""
    many = {**RECORD, "text": "x" * 1_000_000}
    assert command(params(command=["true"]), many).fault == ""  # that it reads nothing is no fault
