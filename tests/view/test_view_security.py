"""Attacks on the viewer's server over raw sockets: who is not its page gets nothing, and nobody holds it up."""

from __future__ import annotations

import socket
import time

import pytest

from fwclass.view.guard import TOKEN
from fwclass.view.server import Server, page_files


def asked(server: Server, text: str | bytes, wait: float = 5.0) -> bytes:
    """What the server answers to raw bytes, until it closes."""
    with socket.create_connection(("127.0.0.1", server.server_port), wait) as connection:
        connection.sendall(text.encode("latin-1") if isinstance(text, str) else text)
        out = b""
        try:
            while piece := connection.recv(65536):
                out += piece
        except (TimeoutError, ConnectionResetError):
            pass
        return out


def request(server: Server, path: str = "/data/0/index.json", method: str = "GET", **headers: str | None) -> bytes:
    """A request as the page makes it; headers that are None are left out."""
    usual: dict[str, str | None] = {"Host": f"127.0.0.1:{server.server_port}", TOKEN: server.guard.token}
    usual |= {k.replace("_", "-"): v for k, v in headers.items()} | {"Connection": "close"}
    lines = [f"{k}: {v}" for k, v in usual.items() if v is not None]
    return asked(server, f"{method} {path} HTTP/1.1\r\n" + "\r\n".join(lines) + "\r\n\r\n")


def status(answer: bytes) -> int:
    return int(answer.split(b" ", 2)[1]) if answer.startswith(b"HTTP/") else 0


def test_the_page_and_its_data_are_answered(server: Server) -> None:
    assert status(request(server)) == 200
    page = request(server, "/")
    assert status(page) == 200 and b"default-src 'none'" in page and b"nosniff" in page
    assert b"<script>" not in page and b"style=" not in page and b" onclick" not in page


@pytest.mark.parametrize(
    "headers",
    [
        {TOKEN: None},
        {TOKEN: ""},
        {TOKEN: "x" * 32},
        {"Host": None},
        {"Host": "evil.example"},
        {"Host": "127.0.0.1"},
        {"Host": "127.0.0.1:1"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
def test_who_is_not_the_page_gets_nothing(server: Server, headers: dict[str, str | None]) -> None:
    answer = request(server, **headers)
    assert status(answer) in (401, 403)
    assert b"demo" not in answer and server.guard.token.encode() not in answer


def test_two_origins_are_none(server: Server) -> None:
    here = f"127.0.0.1:{server.server_port}"
    own = f"Host: {here}\r\nOrigin: http://{here}\r\n{TOKEN}: {server.guard.token}\r\n"
    text = "GET /data/0/index.json HTTP/1.1\r\n{}Connection: close\r\n\r\n"
    assert status(asked(server, text.format(own))) == 200
    assert status(asked(server, text.format(own + "Origin: http://evil.example\r\n"))) == 403


def test_two_hosts_are_none(server: Server) -> None:
    host = f"Host: 127.0.0.1:{server.server_port}\r\n"
    text = f"GET /data/0/index.json HTTP/1.1\r\n{host}Host: evil.example\r\n{TOKEN}: {server.guard.token}\r\n\r\n"
    assert status(asked(server, text)) == 403


@pytest.mark.parametrize(
    "path",
    [
        "/../../../../etc/passwd",
        "/..%2f..%2f..%2fetc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/%252e%252e/etc/passwd",
        "/....//....//etc/passwd",
        "/data/0/../../report.json",
        "/data/0/..%2freport.json",
        "/data/0/echoes/level-0.bin%00.json",
        "/data/0/echoes/%6cevel-0.bin",
        "/data/7/index.json",
        "/data/0/echoes/level--1.bin",
        "/data/0/echoes/level-01.bin",
        "/data/0/echoes/level-99999999999999999.bin",
        "/data/0/echoes/5-999999-0.bin",
        "/data/0/echo/0-0-0/99999999999.json",
        "/data/0/pulse/1-9999999999999.json",
        "/data/0/why/1-1-999.json",
        "/data/0/__class__/level-0.bin",
        "/data/0/geometry/level-0.bin",
        "//etc/passwd",
        "http://127.0.0.1/data/0/index.json",
        "/server.py",
        "/index.html?x=1",
        "/page/",
        "*",
    ],
)
def test_nothing_else_is_a_path(server: Server, path: str) -> None:
    answer = request(server, path)
    assert status(answer) in (400, 404), answer[:300]
    assert b"root:" not in answer and b"Traceback" not in answer


@pytest.mark.parametrize("method", ["HEAD", "POST", "PUT", "DELETE", "OPTIONS", "TRACE", "CONNECT", "PATCH", "BREW"])
def test_other_methods_are_refused(server: Server, method: str) -> None:
    answer = request(server, method=method)
    assert status(answer) in (405, 501)
    assert b"BREW" not in answer


def test_bodies_are_refused_unread(server: Server) -> None:
    assert status(request(server, Content_Length="1000000000000")) == 413
    assert status(request(server, Transfer_Encoding="chunked")) == 413
    assert status(request(server, Content_Length="-1")) == 413


def test_a_head_without_end_is_cut(server: Server) -> None:
    head = f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{server.server_port}\r\n"
    assert status(asked(server, head + "X: " + "a" * 100_000)) != 200
    assert status(asked(server, head + "".join(f"X-{k}: 1\r\n" for k in range(2000)))) != 200
    assert status(asked(server, b"\x00\xff" * 50_000)) != 200
    assert status(request(server)) == 200


def test_a_dripping_head_ends_in_time(server: Server) -> None:
    began = time.monotonic()
    with socket.create_connection(("127.0.0.1", server.server_port), 10) as connection, pytest.raises(OSError):
        for _ in range(100):
            connection.sendall(b"G")
            time.sleep(0.1)
    assert time.monotonic() - began < 6


def test_idle_connections_end_and_make_room(server: Server) -> None:
    idle = [socket.create_connection(("127.0.0.1", server.server_port), 10) for _ in range(20)]
    time.sleep(server.params.request + 0.5)
    assert status(request(server)) == 200
    assert all(one.recv(10) == b"" for one in idle[:8])
    for one in idle:
        one.close()


def test_it_listens_on_this_host_alone(server: Server) -> None:
    assert server.server_address[0] == "127.0.0.1"
    assert server.address.startswith("http://127.0.0.1:") and "#token=" in server.address


def test_the_page_has_nothing_inline_and_no_address_elsewhere() -> None:
    page = page_files()
    for name, data in page.items():
        text = data.decode()
        for word in (
            "innerHTML",
            "outerHTML",
            "insertAdjacentHTML",
            "document.write",
            "eval(",
            "new Function",
            "https://",
        ):
            assert word not in text, (name, word)
        assert "http://" not in text.replace("http://www.w3.org/2000/svg", ""), name
    assert 10_000 < sum(map(len, page.values())) < 300_000
