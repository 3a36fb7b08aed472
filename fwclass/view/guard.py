"""What a request must be like before anything is done for it: from this page, short, whole, in time."""

from __future__ import annotations

import io
import secrets
import socket
import time
from collections.abc import Mapping
from email.message import Message

TOKEN = "X-Fwclass-Token"  # noqa: S105 - a header's name
DELIVERY = "X-Fwclass-Delivery"
"""The name of the delivery that the page began with; left out before it knows."""
CONTENT = (
    "default-src 'none'; script-src 'self'; worker-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content security policy: nothing inline, nothing from elsewhere, no evaluation of text."""

HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": CONTENT,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Guard:
    """Knows the address that the page was opened by, and the token that it must show."""

    def __init__(self, port: int) -> None:
        self.token = secrets.token_urlsafe(24)
        self.hosts = frozenset({f"127.0.0.1:{port}", f"localhost:{port}"})

    def refusal(self, headers: Message[str, str], private: bool, body: int = 0) -> tuple[int, str]:
        """Status and words, or (0, "") for a request that may be answered; it may bring `body` bytes.

        What has a body changes something: it must name the page's own origin, which a browser always does.

        A page elsewhere reaches this address too, by a name that it lets point here: its `Host` is another.
        """
        names = [name.lower() for name in headers]
        if names.count("host") != 1 or headers.get("Host", "") not in self.hosts:
            return 403, "this address is reached as 127.0.0.1 only"
        origin = headers.get("Origin") if names.count("origin") < 2 else ""
        if (origin is not None or body) and origin not in {f"http://{h}" for h in self.hosts}:
            return 403, "a page of another origin"
        if headers.get("Sec-Fetch-Site", "same-origin") not in ("same-origin", "none"):
            return 403, "a page of another site"
        if headers.get("Transfer-Encoding") is not None or not 0 <= body_bytes(headers) <= body:
            return 413, f"requests have at most {body} bytes here" if body else "requests have no body here"
        if body and headers.get("Content-Type", "").partition(";")[0].strip().lower() != "application/json":
            return 415, "requests bring JSON"
        if private and not secrets.compare_digest(headers.get(TOKEN, "").encode(), self.token.encode()):
            return 401, "the address lacks the token that `fwclass view` printed: open that one"
        return 0, ""


def body_bytes(headers: Message[str, str]) -> int:
    """Bytes that a request says it brings; -1 for what is no number, or several."""
    lengths = headers.get_all("Content-Length") or ["0"]
    text = lengths[0].strip()
    return int(text) if len(lengths) == 1 and text.isascii() and text.isdigit() and len(text) < 16 else -1


class BoundedReader(io.RawIOBase):
    """Reads a socket; of every request at most so many bytes, for at most so many seconds."""

    def __init__(self, connection: socket.socket, most: int, seconds: float) -> None:
        self._connection, self._most, self._seconds = connection, most, seconds
        self.begin()

    def begin(self) -> None:
        """A new request may come."""
        self._left, self._until = self._most, time.monotonic() + self._seconds

    def allow(self, count: int) -> None:
        """So many bytes more, in the same time."""
        self._left += count

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: bytearray) -> int:  # type: ignore[override]
        """As `io.RawIOBase.readinto`; `TimeoutError` beyond the limits."""
        wait = self._until - time.monotonic()
        if wait <= 0 or self._left <= 0:
            raise TimeoutError
        self._connection.settimeout(wait)
        try:
            n = self._connection.recv_into(memoryview(buffer)[: self._left])
        finally:
            self._connection.settimeout(self._seconds)
        self._left -= n
        return n
