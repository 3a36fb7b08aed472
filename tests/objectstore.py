"""An S3 server for tests: moto behind real HTTP, with faults on demand."""

from __future__ import annotations

import hashlib
import json
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import boto3
from moto.server import DomainDispatcherApplication, create_backend_app
from werkzeug.serving import WSGIRequestHandler, make_server

from fwclass import conf
from fwclass.store.params import StoreParams
from fwclass.store.url import Url

KEYS = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_REGION": "us-east-1"}

Wsgi = Callable[[dict[str, Any], Any], Iterable[bytes]]


@dataclass
class Trouble:
    """What the server does to requests whose method and path `meant` accepts, the next `times` of them.

    `kind`: "busy" answers 503, "slow" waits `seconds` first, "torn" breaks off in the middle of the answer, "deaf" does
    what was asked and breaks off before it says so, "heedless" answers whatever version of an object was asked for.
    """

    kind: str
    times: int
    meant: Callable[[str, str], bool] = lambda method, path: True
    seconds: float = 0.0


@dataclass
class Faults:
    """A WSGI application around moto's; one request at a time reaches moto, whose conditional writes are not atomic."""

    inner: Wsgi
    troubles: list[Trouble] = field(default_factory=list)
    seen: list[tuple[str, str]] = field(default_factory=list)
    _one: Any = field(default_factory=threading.Lock)
    _guard: Any = field(default_factory=threading.Lock)

    def _met(self, method: str, path: str) -> Trouble | None:
        with self._guard:
            self.seen.append((method, path))
            for trouble in self.troubles:
                if trouble.times > 0 and trouble.meant(method, path):
                    trouble.times -= 1
                    return trouble
        return None

    def __call__(self, environ: dict[str, Any], start: Any) -> Iterable[bytes]:
        trouble = self._met(environ["REQUEST_METHOD"], environ["PATH_INFO"])
        kind = trouble.kind if trouble else ""
        if kind == "busy":
            environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
            start("503 Slow Down", [("Content-Type", "application/xml")])
            return [b"<Error><Code>ServiceUnavailable</Code></Error>"]
        if kind == "slow" and trouble is not None:
            time.sleep(trouble.seconds)
        if kind == "heedless":
            environ.pop("HTTP_IF_MATCH", None)
        told: list[Any] = []
        with self._one:
            answer = b"".join(self.inner(environ, lambda *words: told.append(words)))
        if kind == "deaf":
            return _cut(environ)
        start(*told[0][:2])
        return _torn(environ, answer) if kind == "torn" else [answer]


def _cut(environ: dict[str, Any]) -> Iterable[bytes]:
    environ["werkzeug.socket"].shutdown(socket.SHUT_RDWR)
    raise ConnectionAbortedError


def _torn(environ: dict[str, Any], answer: bytes) -> Iterator[bytes]:
    yield answer[: len(answer) // 2]
    yield from _cut(environ)


class _Quiet(WSGIRequestHandler):
    protocol_version = "HTTP/1.1"

    def log(self, type: str, message: str, *args: Any) -> None:
        pass


@dataclass(frozen=True)
class Server:
    """The server's address, its faults, and a client that meets none of them."""

    address: str
    faults: Faults
    client: Any

    def bucket(self) -> str:
        """A fresh one."""
        name = f"b{uuid.uuid4().hex[:12]}"
        self.client.create_bucket(Bucket=name)
        return name

    def url(self, path: str = "run") -> Url:
        """A place in a fresh bucket."""
        return Url(f"s3://{self.bucket()}/{path}")

    def keys(self, url: Url) -> list[str]:
        """What the keys of all objects below `url` have after it."""
        bucket, _, prefix = url.removeprefix("s3://").partition("/")
        pages = self.client.get_paginator("list_objects_v2").paginate(Bucket=bucket, Prefix=f"{prefix}/")
        return [held["Key"][len(prefix) + 1 :] for page in pages for held in page.get("Contents", ())]

    def read(self, url: Url) -> dict[str, bytes]:
        """Every object below `url`, by what its key has after it; nobody writes there."""
        bucket, _, prefix = url.removeprefix("s3://").partition("/")
        return {
            key: self.client.get_object(Bucket=bucket, Key=f"{prefix}/{key}")["Body"].read() for key in self.keys(url)
        }

    def write(self, url: Url, data: bytes) -> None:
        bucket, _, key = url.removeprefix("s3://").partition("/")
        self.client.put_object(Bucket=bucket, Key=key, Body=data)

    def write_all(self, url: Url, directory: Path, *below: str) -> None:
        """Copy the files of these directories below `directory`."""
        for path in (p for name in below for p in (directory / name).rglob("*") if p.is_file()):
            self.write(url / path.relative_to(directory).as_posix(), path.read_bytes())

    def delivered(self, url: Url) -> dict[str, str]:
        """Digest of every file of the generation that readers see, but of the report, as `runmaker.delivered`."""
        address = json.loads(self.read(url)["current.json"])["address"]
        there = self.read(url / address)
        kinds = ("laz", "parquet", "rasters", "model")
        shown = (n for n in there if n.split("/")[0] in kinds or ("/" not in n and n.endswith(".gpkg")))
        return {n: hashlib.sha256(there[n]).hexdigest() for n in shown}

    def remove(self, url: Url) -> None:
        bucket, _, key = url.removeprefix("s3://").partition("/")
        self.client.delete_object(Bucket=bucket, Key=key)

    @contextmanager
    def trouble(self, *troubles: Trouble) -> Iterator[None]:
        self.faults.troubles[:] = troubles
        try:
            yield
        finally:
            self.faults.troubles.clear()


@contextmanager
def serving(host: str = "127.0.0.1") -> Iterator[Server]:
    """An S3 server at this address of this host as long as the block lasts."""
    moto = DomainDispatcherApplication(create_backend_app)
    calm = make_server("127.0.0.1", 0, moto, threaded=True, request_handler=_Quiet)
    faults = Faults(moto)
    front = make_server(host, 0, faults, threaded=True, request_handler=_Quiet)
    for one in (calm, front):
        threading.Thread(target=one.serve_forever, args=(0.02,), daemon=True).start()
    client = boto3.client(
        "s3",
        endpoint_url=f"http://127.0.0.1:{calm.server_port}",
        region_name=KEYS["AWS_REGION"],
        aws_access_key_id="test",
        aws_secret_access_key="test",  # noqa: S106
    )
    try:
        yield Server(f"http://{host}:{front.server_port}", faults, client)
    finally:
        for one in (calm, front):
            one.shutdown()


def used(server: Server, copies: Path) -> dict[str, str]:
    """What a process needs in its environment to use the server, with its copies below `copies`."""
    return {**KEYS, "AWS_ENDPOINT_URL": server.address, "FWCLASS_SCRATCH": str(copies)}


def quick(**change: Any) -> StoreParams:
    """The section `store` for a server that is near: what takes minutes takes a second."""
    given = {"timeout": 3.0, "patience": 10.0, "beat": 0.1, "dead": 0.8, "scratch_gib": 1.0, **change}
    return conf.section("store", tuple(f"store.{name}={value}" for name, value in given.items()))
