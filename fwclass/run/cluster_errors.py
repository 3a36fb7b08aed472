"""What is said of a Dask scheduler that does not answer, and of workers that compute by other code than the run."""

from __future__ import annotations

from collections.abc import Mapping

from fwclass.errors import FwclassError
from fwclass.store.libraries import changes, fingerprint

SHOWN_WORKERS = 10
"""Workers that are named of those that differ."""


class OtherLibraries(Exception):
    """A worker computes by other code than the run: its address, and its `libraries.fingerprint`."""


def difference_from_here(there: Mapping[str, str]) -> str:
    """How the libraries of a worker differ from those of this process, in words; empty where they do not."""
    return ", ".join(changes(fingerprint(), there))


def no_answer(address: str | None, encrypted: bool, fault: Exception) -> FwclassError:
    """Nobody speaks at `address`, or not to us; None for workers of this machine."""
    if (address or "").startswith("tls://") or encrypted:
        return FwclassError(
            "no Dask scheduler answers, or not to this certificate",
            where=address or "local cluster",
            got=fault,
            do="name certificates of the scheduler's authority in Dask's distributed.comm.tls: ca-file, client.cert, "
            "client.key, and those of scheduler and worker where these run (docs/security.md)",
        )
    if address is None:
        return FwclassError(
            "the workers of this machine do not start, or end at once",
            where="local cluster",
            got=fault,
            do="give each more memory (run.worker_memory_gib; `fwclass plan` tells what it needs), or go without: "
            "--workers 0",
        )
    return FwclassError(
        "no Dask scheduler answers",
        where=address,
        got=fault,
        do="start one with `dask scheduler`, or leave --scheduler out for a local cluster; one that speaks TLS has an "
        "address tls://…",
    )


def scheduler_gone(address: str) -> FwclassError:
    """A scheduler does not answer any more."""
    return FwclassError(
        "the Dask scheduler is gone",
        where=address,
        do="start it and its workers again, then run the same command; what is done is kept",
    )


def unlike_workers(address: str, others: list[str], count: int) -> FwclassError:
    """Of `count` workers `others`, each with its address, compute by other code than this process."""
    more = f"\n    and {len(others) - SHOWN_WORKERS} more" if len(others) > SHOWN_WORKERS else ""
    return FwclassError(
        f"{len(others)} of {count} workers compute by other code than this run",
        where=address,
        expected="the same fwclass and libraries on all hosts: parts would come out otherwise on some",
        got="\n    ".join(["", *others[:SHOWN_WORKERS]]) + more,
        do="install the same on all hosts (requirements.lock), and start the workers again",
    )


def program_changed(address: str, text: str) -> FwclassError:
    """A worker of this machine was started from other code than the run: `text` says which."""
    return FwclassError(
        "the program was changed while it ran", where=address, got=text, do="run the same again; what is done is kept"
    )
