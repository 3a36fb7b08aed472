"""What object storage answers, in words for the user."""

from __future__ import annotations

import re

from fwclass.errors import StoreError

_CREDENTIALS = (
    "give the process credentials (AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or the host's role), with the right to "
    "list, read, write and delete below this address; every worker needs them too"
)
_BUSY = "SlowDown"
"""The answer that another try may not get."""
_ADVICE = (
    ("169.254.169.254", "object storage needs credentials, and there are none", _CREDENTIALS),
    (
        "object with invalid path",
        "object storage holds an object with a name that no run gives",
        "remove it with the storage's own tools: nothing can be listed beside it; nobody but runs should write there",
    ),
    ("NoSuchBucket", "there is no such bucket", "check the bucket's name, AWS_REGION and AWS_ENDPOINT_URL"),
    ("incorrectly configured region", "the bucket lies in another region", "set AWS_REGION to the bucket's region"),
    ("RequestTimeTooSkewed", "this host's clock is wrong", "set the clock; requests are signed with the time"),
    (_BUSY, "object storage is overloaded", "run the same again later, or with a smaller store.parallel"),
)


class LostRace(StoreError):
    """Somebody else wrote the object first."""


class Unreachable(StoreError):
    """Object storage did not do what was asked, as often as it was asked."""


def first_line(fault: BaseException) -> str:
    """What a fault says, without the library's structures."""
    text = str(fault).split("\n\nDebug source")[0]
    code = re.search(r"<Code>([^<]*)</Code>", text)
    return " ".join(re.sub(r"<\?xml.*", f"({code[1]})" if code else "", text, flags=re.S).split())[:300]


def as_store_error(fault: BaseException, where: object, seconds: float) -> StoreError:
    """A fault that obstore raised, at `where`, after `seconds` of trying."""
    kind, text = type(fault).__name__, str(fault)
    for sign, what, do in _ADVICE:
        if sign in text:
            return Unreachable(what, where=where, got=first_line(fault), do=do)
    if kind in ("PermissionDeniedError", "UnauthenticatedError") or re.search(r"status code: 40[13]\b", text):
        return Unreachable("object storage refuses access", where=where, got=first_line(fault), do=_CREDENTIALS)
    return Unreachable(
        f"object storage does not answer as it should, for {seconds:.0f} s",
        where=where,
        got=first_line(fault),
        do="check the network, AWS_ENDPOINT_URL and AWS_REGION, then run the same again: what is done is kept",
    )


def lasting(fault: BaseException) -> bool:
    """Trying again will not help."""
    kind, text = type(fault).__name__, str(fault)
    if kind in ("PermissionDeniedError", "UnauthenticatedError", "NotSupportedError", "InvalidPathError"):
        return True
    return (
        any(sign in text for sign, _, _ in _ADVICE if sign != _BUSY)
        or re.search(r"status code: 40[0134]\b", text) is not None
    )
