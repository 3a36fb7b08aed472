"""Notices of a scheduled run's end, by webhook and by a command. Neither ever fails a run, and no secret is in them."""

from __future__ import annotations

import base64
import contextlib
import http.client
import json
import os
import signal
import socket
import subprocess
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import unquote, urlsplit

from fwclass import __version__
from fwclass.conf.schedule import ScheduleSection
from fwclass.isolation import outer_environment
from fwclass.operate.schedule.child import Signals, without
from fwclass.operate.schedule.ticks import now
from fwclass.redact import redacted

STEPS = 4
"""Of a try: connection, encryption, request, answer. Of this only status and heads are read."""

REPEATED = frozenset({408, 425, 429, 500, 502, 503, 504})
"""Answers after which the same may succeed later."""


class _Unheeding(urllib.request.HTTPRedirectHandler):
    """No redirection is followed: it could carry the token, or the record, to another host."""

    def redirect_request(self, *words: Any, **named: Any) -> None:
        return None


class _Held(urllib.request.HTTPHandler):
    """Keeps the connections that it makes, so that they can be ended: heads that come one letter at a time, or are put
    off for ever (100 Continue), hold no time of the socket's up."""

    def __init__(self, kept: list[http.client.HTTPConnection]) -> None:
        super().__init__()
        self._kept = kept

    def do_open(self, http_class: Any, req: urllib.request.Request, **words: Any) -> Any:
        def connection(host: str, **named: Any) -> http.client.HTTPConnection:
            self._kept.append(http_class(host, **named))
            return self._kept[-1]

        return super().do_open(connection, req, **words)


class _HeldSafe(_Held, urllib.request.HTTPSHandler):
    """The same of encrypted ones."""


@dataclass(frozen=True)
class SendResult:
    """How it went: empty `fault` is well."""

    address: str
    fault: str = ""
    tries: int = 1

    def as_data(self) -> dict[str, Any]:
        """As plain data, for the history."""
        return {"to": self.address, "ok": not self.fault, "fault": self.fault, "tries": self.tries}


def tell_within(
    params: ScheduleSection, record: Mapping[str, Any], signals: Signals, beat: Callable[[], None]
) -> dict[str, Any]:
    """As `tell`, in a thread of its own, so that neither signals nor `beat` wait for a slow service.

    Given up when the schedule is told to stop a second time, or when all tries should long be over.
    """
    results: dict[str, Any] = {}
    if params.webhook is None and not params.command:
        return results

    def work() -> None:
        results.update(tell(params, record, lambda: signals.first is not None))
        signals.wake()

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    ends = now().steady + longest(params)
    while thread.is_alive() and now().steady < ends and signals.count < 2:
        beat()
        signals.wait(params.look)
    return dict(results) or {"webhook": SendResult("", "given up", 0).as_data()}


def longest(params: ScheduleSection) -> float:
    """How long webhook and command may take together [s]; a try has some steps, each with its own time."""
    pauses = params.webhook_pause * (2 ** (params.webhook_tries - 1) - 1)
    return params.webhook_tries * STEPS * params.webhook_timeout + pauses + params.command_timeout + params.look


def tell(params: ScheduleSection, record: Mapping[str, Any], stop: Callable[[], bool]) -> dict[str, Any]:
    """Send `record` to the webhook and the command that `params` name; how each went. `stop`: no further tries."""
    results: dict[str, Any] = {}
    if params.webhook is not None:
        results["webhook"] = post(params, record, stop).as_data()
    if params.command:
        results["command"] = command(params, record).as_data()
    return results


def post(params: ScheduleSection, record: Mapping[str, Any], stop: Callable[[], bool]) -> SendResult:
    """POST `record` as JSON; tried again after a pause where the service was busy or did not answer."""
    assert params.webhook is not None  # noqa: S101 - who calls has looked
    address = redacted(params.webhook.get_secret_value())
    fault, pause = "", params.webhook_pause
    token = os.environ.get(params.webhook_token_env) if params.webhook_token_env else None
    if params.webhook_token_env and not token:
        return SendResult(address, f"the environment variable {params.webhook_token_env} is not set", 0)
    for number in range(1, params.webhook_tries + 1):
        fault, again = _try(_request(params.webhook.get_secret_value(), token, record), params.webhook_timeout)
        if not again or number == params.webhook_tries or _paused(pause, stop):
            return SendResult(address, fault, number)
        pause *= 2
    return SendResult(address, fault, params.webhook_tries)


def _request(address: str, token: str | None, record: Mapping[str, Any]) -> urllib.request.Request:
    """The address's user goes into the header, where no log of a proxy shows it."""
    parts = urlsplit(address)
    user, _, host = parts.netloc.rpartition("@")
    headers = {"Content-Type": "application/json", "User-Agent": f"fwclass/{__version__}"}
    if user:
        headers["Authorization"] = "Basic " + base64.b64encode(unquote(user).encode()).decode()
    request = urllib.request.Request(  # noqa: S310 - the configuration takes http and https only
        parts._replace(netloc=host, fragment="").geturl(), json.dumps(record).encode(), headers, method="POST"
    )
    if token:
        request.add_unredirected_header("Authorization", f"Bearer {token}")
    return request


def _try(request: urllib.request.Request, timeout: float) -> tuple[str, bool]:
    """What went wrong, empty for nothing, and whether to try again.

    Texts of exceptions are not told: they may quote the address.
    """
    kept: list[http.client.HTTPConnection] = []
    over = threading.Event()

    def end() -> None:
        over.set()
        for one in kept:
            with contextlib.suppress(AttributeError, OSError):
                one.sock.shutdown(socket.SHUT_RDWR)

    late = threading.Timer(STEPS * timeout, end)
    late.daemon = True
    late.start()
    try:
        return _opened(urllib.request.build_opener(_Unheeding(), _HeldSafe(kept)), request, timeout, over)
    finally:
        late.cancel()


def _opened(
    opener: urllib.request.OpenerDirector, request: urllib.request.Request, timeout: float, over: threading.Event
) -> tuple[str, bool]:
    """As `_try`, which sets `over` when it ends the connection."""
    try:
        opener.open(request, timeout=timeout).close()
        return "", False
    except urllib.error.HTTPError as fault:
        fault.close()
        if 300 <= fault.code < 400:
            return f"answered {fault.code}: it redirects, which is not followed; name the final address", False
        return f"answered {fault.code}", fault.code in REPEATED
    except urllib.error.URLError as fault:
        return _words(TimeoutError() if over.is_set() else fault.reason), True
    except (OSError, http.client.HTTPException) as fault:
        return _words(TimeoutError() if over.is_set() else fault), not isinstance(fault, http.client.InvalidURL)
    except ValueError as fault:
        return _words(fault), False


def _words(fault: object) -> str:
    if isinstance(fault, TimeoutError):
        return "no answer in time"
    if isinstance(fault, OSError) and fault.strerror:
        return f"{type(fault).__name__}: {fault.strerror}"
    return type(fault).__name__


def _paused(seconds: float, stop: Callable[[], bool]) -> bool:
    """Wait; True if the schedule was told to stop meanwhile."""
    ends = time.monotonic() + seconds
    while not stop() and time.monotonic() < ends:
        time.sleep(min(0.1, max(0.0, ends - time.monotonic())))
    return stop()


def command(params: ScheduleSection, record: Mapping[str, Any]) -> SendResult:
    """Run the command with `record` on its standard input; what it prints goes to standard error."""
    words, name = list(params.command), os.path.basename(params.command[0])  # noqa: PTH119 - a word, maybe no path
    facts = {
        "FWCLASS_RUN": record.get("run"),
        "FWCLASS_WORD": record.get("word"),
        "FWCLASS_ID": record.get("id"),
        "FWCLASS_EXIT_CODE": record.get("exit_code"),
        "FWCLASS_TRIGGER": record.get("why", {}).get("trigger"),
    }
    environment = without(params.webhook_token_env, outer_environment())
    environment |= {k: str(v) for k, v in facts.items() if v is not None}
    try:
        process = subprocess.Popen(  # noqa: S603 - the user's own command, without a shell
            words, stdin=subprocess.PIPE, stdout=2, env=environment, start_new_session=True
        )
    except (OSError, ValueError) as fault:
        return SendResult(name, f"it could not be started: {_words(fault)}")
    try:
        process.communicate(json.dumps(record).encode(), params.command_timeout)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return SendResult(name, f"it took longer than {params.command_timeout:g} s and was ended")
    return SendResult(name, "" if process.returncode == 0 else f"exit code {process.returncode}")
