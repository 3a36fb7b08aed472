"""Places on object storage, and which words mean one."""

from __future__ import annotations

from fwclass.errors import ConfigError

SCHEMES = ("s3", "gs", "az", "abfs", "abfss", "memory")
"""`memory` lasts as long as the process: for tests."""


class Url(str):
    """A place on object storage, without a slash at its end; ``/`` goes below it, as with a path."""

    __slots__ = ()

    def __truediv__(self, name: object) -> Url:
        return Url(f"{self}/{name}")

    @property
    def name(self) -> str:
        return self.rsplit("/", 1)[-1]

    @property
    def parent(self) -> Url:
        return Url(self.rsplit("/", 1)[0])


def is_url(text: object) -> bool:
    """`text` is an address, not a path."""
    return "://" in str(text)


def url_of(text: str, where: str) -> Url:
    """`text` as a place on object storage; `ConfigError` for what is none. `where` names its origin."""
    scheme, _, rest = text.partition("://")
    bucket, _, path = rest.partition("/")
    parts = [p for p in path.split("/") if p]
    if scheme not in SCHEMES or (not bucket and scheme != "memory") or any(p in (".", "..") for p in parts):
        raise ConfigError(
            "this is no place on object storage",
            where=where,
            expected=f"for example s3://bucket/directory ({', '.join(SCHEMES[:-1])})",
            got=text,
            do="check the address",
        )
    if ":" in bucket or ("@" in bucket and not scheme.startswith("abfs")):  # there it is container@account
        raise ConfigError(
            "an address of object storage holds no user and no key",
            where=where,
            expected="for example s3://bucket/directory",
            got=text,
            do="give credentials in the environment (docs/many-machines.md), and make a new key if this was one",
        )
    return Url("/".join([f"{scheme}://{bucket}", *parts]))
