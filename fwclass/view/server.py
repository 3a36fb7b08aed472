"""The viewer's server: the page's files, and answers of scenes, on 127.0.0.1 alone."""

from __future__ import annotations

import io
import json
import os
import re
import socket
import threading
from collections.abc import Callable, Mapping, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

from fwclass.errors import ConfigError, FwclassError, InputError
from fwclass.redact import redacted
from fwclass.view.guard import DELIVERY, HEADERS, BoundedReader, Guard, body_bytes
from fwclass.view.params import ViewParams
from fwclass.view.scene import Again, Gone, Replaced, Scene
from fwclass.view.selection import Selection

KINDS = {".html": "text/html; charset=utf-8", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
JSON, BYTES = "application/json", "application/octet-stream"

_NUMBER = r"(0|[1-9]\d{0,18})"
_NODE = rf"{_NUMBER}-{_NUMBER}-{_NUMBER}"
_PART = r"([a-z][a-z0-9_]{0,63})"

Answer = Callable[..., tuple[str, bytes]]


def page_files() -> dict[str, bytes]:
    """The page by name, as the package has it."""
    return {f.name: f.read_bytes() for f in files("fwclass.view").joinpath("page").iterdir() if f.is_file()}


def _json(value: Any) -> tuple[str, bytes]:
    return JSON, json.dumps(value, allow_nan=False, separators=(",", ":")).encode()


ROUTES: tuple[tuple[re.Pattern[str], Answer], ...] = tuple(
    (re.compile(rf"/data/(0|1)/{pattern}", re.ASCII), answer)
    for pattern, answer in (
        (r"index\.json", lambda scene: _json(scene.index())),
        (r"work\.json", lambda scene: _json(scene.work())),
        (rf"{_PART}/scale\.json", lambda scene, part: _json(scene.scale(part))),
        (rf"{_PART}/level-{_NUMBER}\.bin", lambda scene, part, level: (BYTES, scene.level(part, int(level)))),
        (rf"{_PART}/{_NODE}\.bin", lambda scene, part, *node: (BYTES, scene.node(part, tuple(map(int, node))))),
        (rf"echo/{_NODE}/{_NUMBER}\.json", lambda scene, *at: _json(scene.echo(tuple(map(int, at[:3])), int(at[3])))),
        (rf"pulse/{_NUMBER}-{_NUMBER}\.json", lambda scene, *who: _json(scene.pulse(*map(int, who)))),
        (rf"why/{_NODE}\.json", lambda scene, *who: _json(scene.why(*map(int, who)))),
        (rf"marks-{_NUMBER}\.bin", lambda scene, number: (BYTES, scene.relabel.marks(int(number)))),
        (rf"changes-{_NUMBER}\.bin", lambda scene, known: (BYTES, scene.relabel.changes(int(known)))),
    )
)
"""Every address that is answered with GET, besides the page's own files and `RUN`; nothing in them is decoded."""

RUN = "/data/run.json"

CHANGING: Mapping[str, Callable[[Server, Any], Any]] = {
    "/data/0/relabel.json": lambda server, _: server.scenes[0].relabel.begin(),
    "/data/0/select.json": lambda server, sent: server.scenes[0].relabel.select(Selection.of(sent)),
    "/data/0/correct.json": lambda server, sent: server.scenes[0].relabel.correct(
        _whole(sent, "selection"), _code(sent)
    ),
    "/data/0/revert.json": lambda server, sent: server.scenes[0].relabel.revert(_whole(sent, "time")),
    "/data/0/reopen.json": lambda server, _: server.reopen(),
    RUN: lambda server, _: server.again.start(),
    "/data/stop.json": lambda server, _: server.again.stop(),
}
"""What the page asks for with JSON: all that writes, starts or takes long."""


def _whole(sent: Any, name: str) -> int:
    """A number of a request; `InputError` for none."""
    value = sent.get(name) if isinstance(sent, dict) else None
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**53:
        raise InputError(f"{name}: not as the page sends it", where="the page's request", do="reload the page")
    return value


def _code(sent: Any) -> int | None:
    """A class, None for taking back; `InputError` where the request does not say."""
    named = isinstance(sent, dict) and "code" in sent
    return None if named and sent["code"] is None else _whole(sent, "code")


class NotAgain:
    """For servers of scenes whose command is not known."""

    def start(self) -> dict[str, Any]:
        """Refused."""
        raise InputError("nothing may be started from this page", where="the viewer", do="type the command yourself")

    stop = start

    def state(self) -> dict[str, Any]:
        """Nothing runs."""
        return {"allowed": False, "command": "", "why": "", "running": False, "code": None, "lines": []}


class Server(ThreadingHTTPServer):
    """Serves scenes until it is shut down.

    `ConfigError`: the port is taken, or none of this host.
    """

    daemon_threads = True
    allow_reuse_address = os.name == "posix"  # there a port that waits is free, and one that is listened on is not
    request_queue_size = 32
    scenes: list[Scene]
    again: Again

    def __init__(self, scenes: Sequence[Scene], params: ViewParams, port: int = 0, again: Again | None = None) -> None:
        self.scenes, self.params, self.page = list(scenes), params, page_files()
        self.again = again or NotAgain()
        self._free = threading.BoundedSemaphore(params.connections)
        try:
            super().__init__(("127.0.0.1", port), _Handler)
        except OSError as fault:
            raise ConfigError(
                "the port cannot be had",
                where=f"127.0.0.1:{port}",
                expected="a port that nothing listens on",
                got=fault.strerror or fault,
                do="name another with --port, or leave --port out: any free one is taken",
            ) from fault
        self.guard = Guard(self.server_port)

    @property
    def address(self) -> str:
        """Where the page is, with the token: who knows it may read the run."""
        return f"http://127.0.0.1:{self.server_port}/#token={self.guard.token}"

    def reopen(self) -> dict[str, Any]:
        """Show the delivery that is current now, where one run is shown."""
        if len(self.scenes) > 1:
            raise InputError("two runs are compared", where="the viewer", do="end `fwclass view` and start it again")
        self.scenes[0] = self.scenes[0].reopened()
        return {"delivery": self.scenes[0].name}

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except BaseException:
            self._free.release()
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Whoever hangs up, or comes too late, is not told of."""


NO_REQUEST = frozenset({400, 414, 431, 501, 505})
"""Codes by which Python's server refuses what is no request, in words that repeat it."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True  # an answer's head waited 40 ms for the browser's word that it came
    server_version, sys_version = "fwclass", ""
    server: Server
    connection: socket.socket

    def setup(self) -> None:
        super().setup()
        params = self.server.params
        self.connection.settimeout(params.request)
        self._bounded = BoundedReader(self.connection, params.head, params.request)
        self.rfile = io.BufferedReader(self._bounded)  # type: ignore[type-var]

    def handle_one_request(self) -> None:
        self._bounded.begin()
        super().handle_one_request()

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: addresses would stand in a log."""

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Also of requests that are none; their words are never repeated."""
        self.close_connection = True
        self._answer(code, JSON, json.dumps({"error": "no such request" if code in NO_REQUEST else message}).encode())

    def do_GET(self) -> None:
        """Answer, or say why not."""
        path, _, query = self.path.partition("?")
        private = path.startswith("/data/")
        status, words = self.server.guard.refusal(self.headers, private)
        if status:
            self.send_error(status, words)
        elif query or not private:
            self._file("index.html" if path == "/" else path[1:], bool(query))
        else:
            self._answer(*self._outcome(404, lambda: self._data(path)))

    def do_POST(self) -> None:
        """Do what the page asks for, or say why not."""
        change = CHANGING.get(self.path)
        if change is None:
            self.send_error(405, "GET alone")
            return
        most = self.server.params.body
        status, words = self.server.guard.refusal(self.headers, True, most)
        if status:
            self.send_error(status, words)
            return
        size = body_bytes(self.headers)
        self._bounded.allow(size)
        body = self.rfile.read(size)
        if len(body) < size:
            self.send_error(400)
            return
        self._answer(*self._outcome(400, lambda: self._changed(change, body)))

    def _changed(self, change: Callable[[Server, Any], Any], body: bytes) -> tuple[str, bytes]:
        if self.path.startswith("/data/0/") and not self.path.endswith("/reopen.json"):
            self._check_delivery(self.server.scenes[0])
        try:
            sent = json.loads(body, parse_constant=float)
        except (ValueError, RecursionError):
            raise InputError("the request is no JSON", where="the page's request", do="reload the page") from None
        return _json(change(self.server, sent))

    def _outcome(self, refused: int, answer: Callable[[], tuple[str, bytes]]) -> tuple[int, str, bytes]:
        """Status and answer; every fault becomes a sentence."""
        try:
            return 200, *answer()
        except Replaced as fault:
            return 409, *_json({"error": redacted(str(fault)), "replaced": True})
        except Gone as fault:
            return 410, *_json({"error": redacted(str(fault))})
        except FwclassError as fault:
            return refused, *_json({"error": redacted(str(fault))})
        except OSError as fault:
            words = f"the delivery cannot be read any more ({fault.strerror}): a new one may have taken its place; "
            return 410, *_json({"error": words + "end `fwclass view` and start it again"})
        except Exception as fault:
            words = f"the viewer has a fault of its own ({type(fault).__name__}), which is to be reported; "
            return 500, *_json({"error": words + "reload the page and see whether what was asked for is done"})

    def _check_delivery(self, scene: Scene) -> None:
        """`Replaced` where the page began with another delivery."""
        began = self.headers.get(DELIVERY, scene.name)
        if began != scene.name:
            raise Replaced(
                "this page shows a delivery that was replaced",
                where="the viewer",
                expected=f"delivery {scene.name}",
                got=f"delivery {began[:80]}",
                do="reload the page",
            )

    def do_HEAD(self) -> None:
        """Not answered: nothing needs it."""
        self.send_error(405, "GET alone")

    do_PUT = do_DELETE = do_OPTIONS = do_PATCH = do_TRACE = do_CONNECT = do_HEAD

    def _file(self, name: str, query: bool) -> None:
        """A file of the page, by its name in the package."""
        body = None if query else self.server.page.get(name)
        if body is None:
            self._answer(404, *_json({"error": "there is nothing here"}))
        else:
            self._answer(200, KINDS.get("." + name.rpartition(".")[2], BYTES), body)

    def _data(self, path: str) -> tuple[str, bytes]:
        if path == RUN:
            return _json(self.server.again.state())
        for pattern, answer in ROUTES:
            match = pattern.fullmatch(path)
            if match and int(match[1]) < len(self.server.scenes):
                scene = self.server.scenes[int(match[1])]
                self._check_delivery(scene)
                return answer(scene, *match.groups()[1:])
        raise FwclassError("there is nothing here", where="the viewer's server")

    def _answer(self, status: int, kind: str, body: bytes) -> None:
        self.send_response_only(status)
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)
