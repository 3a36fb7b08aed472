"""An S3 server for races: requests are served at the same time, each is atomic for its key alone, and late or
unanswered as a seed says. It keeps a log of all that was done, in the order in which it was done."""

from __future__ import annotations

import hashlib
import random
import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from email.utils import formatdate
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit
from xml.sax.saxutils import escape

LATE = 0.01
"""Most seconds that a request waits before, and that its answer waits after."""


@dataclass(frozen=True)
class Change:
    """Something that was done: an object was put (`data`) or removed (None)."""

    key: str
    data: bytes | None


@dataclass
class Bucket:
    """Objects by key, as bucket/key; `log`: every change."""

    objects: dict[str, bytes] = field(default_factory=dict)
    log: list[Change] = field(default_factory=list)
    lost: float = 0.0
    rng: random.Random = field(default_factory=lambda: random.Random(1))  # noqa: S311
    met: int = 0
    most: int = 0
    _guard: Any = field(default_factory=threading.Lock)

    @contextmanager
    def under_way(self) -> Iterator[None]:
        """Counts the requests that are served at the same time."""
        with self._guard:
            self.met += 1
            self.most = max(self.most, self.met)
        try:
            yield
        finally:
            with self._guard:
                self.met -= 1

    def put(self, key: str, data: bytes, absent: bool, match: str | None) -> bool:
        """Whether the condition held, and the object was put."""
        with self._guard:  # an instant: all waiting is outside of it
            held = self.objects.get(key)
            if (absent and held is not None) or (match is not None and (held is None or etag(held) != match)):
                return False
            self.objects[key] = data
            self.log.append(Change(key, data))
            return True

    def remove(self, key: str) -> None:
        with self._guard:
            if self.objects.pop(key, None) is not None:
                self.log.append(Change(key, None))

    def held(self) -> dict[str, bytes]:
        with self._guard:
            return dict(self.objects)

    def chance(self) -> float:
        with self._guard:
            return self.rng.random()


def etag(data: bytes) -> str:
    return f'"{hashlib.md5(data).hexdigest()}"'  # noqa: S324 - as S3 does


class Handler(BaseHTTPRequestHandler):
    """Put, conditional put, copy, get (ranges, If-Match), list, delete one and many."""

    protocol_version = "HTTP/1.1"
    bucket: Bucket

    def log_message(self, *words: object) -> None:
        pass

    def _begin(self) -> tuple[str, dict[str, list[str]], bytes]:
        data = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        parts = urlsplit(self.path)
        return unquote(parts.path).strip("/"), parse_qs(parts.query, keep_blank_values=True), data

    def _serve(self) -> None:
        key, asked, data = self._begin()
        bucket = self.bucket
        with bucket.under_way():
            time.sleep(bucket.chance() * LATE)
            status, headers, body = self._done(key, asked, data)
            time.sleep(bucket.chance() * LATE)
            if bucket.chance() < bucket.lost:
                self.close_connection = True
                self.connection.close()
                return
            self.send_response(status)
            for name, value in {"Content-Length": str(len(body)), **headers}.items():
                self.send_header(name, value)
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(body)

    do_GET = do_PUT = do_POST = do_DELETE = do_HEAD = _serve

    def _done(self, key: str, asked: dict[str, list[str]], data: bytes) -> tuple[int, dict[str, str], bytes]:
        if self.command == "PUT":
            return self._put(key, data)
        if self.command == "POST" and "delete" in asked:
            keys = [unquote(k) for k in re.findall(r"<Key>(.*?)</Key>", data.decode())]
            for one in keys:
                self.bucket.remove(f"{key}/{one}")
            gone = "".join(f"<Deleted><Key>{escape(k)}</Key></Deleted>" for k in keys)
            return 200, {}, f"<DeleteResult>{gone}</DeleteResult>".encode()
        if self.command == "DELETE":
            self.bucket.remove(key)
            return 204, {}, b""
        if "list-type" in asked:
            return (
                200,
                {"Content-Type": "application/xml"},
                self._listed(key, asked["prefix"][0] if "prefix" in asked else ""),
            )
        return self._got(key)

    def _put(self, key: str, data: bytes) -> tuple[int, dict[str, str], bytes]:
        source = self.headers.get("x-amz-copy-source")
        if source is not None:
            found = self.bucket.held().get(unquote(source).strip("/"))
            if found is None:
                return 404, {}, b"<Error><Code>NoSuchKey</Code></Error>"
            data = found
        absent, match = self.headers.get("If-None-Match") == "*", self.headers.get("If-Match")
        if not self.bucket.put(key, data, absent, match):
            return 412, {}, b"<Error><Code>PreconditionFailed</Code></Error>"
        body = f"<CopyObjectResult><ETag>{escape(etag(data))}</ETag></CopyObjectResult>" if source else ""
        return 200, {"ETag": etag(data)}, body.encode()

    def _got(self, key: str) -> tuple[int, dict[str, str], bytes]:
        data = self.bucket.held().get(key)
        if data is None:
            return 404, {}, b"<Error><Code>NoSuchKey</Code></Error>"
        if self.headers.get("If-Match") not in (None, etag(data)):
            return 412, {}, b"<Error><Code>PreconditionFailed</Code></Error>"
        facts = {"ETag": etag(data), "Last-Modified": formatdate(usegmt=True)}
        ranged = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range") or "")
        if ranged is None:
            return 200, facts, data
        low, high = int(ranged[1]), min(int(ranged[2]), len(data) - 1)
        return 206, {**facts, "Content-Range": f"bytes {low}-{high}/{len(data)}"}, data[low : high + 1]

    def _listed(self, bucket: str, prefix: str) -> bytes:
        rows = "".join(
            f"<Contents><Key>{escape(k[len(bucket) + 1 :])}</Key><Size>{len(d)}</Size><ETag>{escape(etag(d))}</ETag>"
            "<LastModified>2026-01-01T00:00:00.000Z</LastModified></Contents>"
            for k, d in sorted(self.bucket.held().items())
            if k.startswith(f"{bucket}/{prefix}")
        )
        return f"<ListBucketResult><IsTruncated>false</IsTruncated>{rows}</ListBucketResult>".encode()


@contextmanager
def racing(lost: float, seed: int) -> Iterator[tuple[str, Bucket]]:
    """The server's address, and what it holds; the share `lost` of requests is done and not answered."""
    bucket = Bucket(lost=lost, rng=random.Random(seed))  # noqa: S311
    server = ThreadingHTTPServer(("127.0.0.1", 0), type("Bound", (Handler,), {"bucket": bucket}))
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", bucket
    finally:
        server.shutdown()
        server.server_close()
