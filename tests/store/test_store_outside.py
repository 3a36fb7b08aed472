"""Files of a survey on object storage: found, fetched once on every host, and checked."""

from __future__ import annotations

import itertools

import pytest
from objectstore import Server, Trouble, quick

from fwclass.errors import InputError
from fwclass.store.atomic import file_digest
from fwclass.store.remote_file import directory_outside, find_remote, local
from fwclass.store.url import Url

NAMES = ("strips/a.las", "strips/a.wdp", "strips/A2.LAS", "strips/a.txt", "strips/deep/b.las", "flight.csv", "o[1].las")


@pytest.fixture
def survey(s3: Server) -> Url:
    url = s3.url("survey")
    for name in NAMES:
        s3.write(url / name, name.encode())
    s3.write(url.parent / "survey2/strips/a.las", b"of another survey")
    return url


@pytest.mark.parametrize(
    ("pattern", "found"),
    [
        ("strips/*.las", ["strips/a.las"]),
        ("strips/a.las", ["strips/a.las"]),
        ("**/*.las", ["o[1].las", "strips/a.las", "strips/deep/b.las"]),
        ("strips/[aA]*.[lL][aA][sS]", ["strips/A2.LAS", "strips/a.las"]),
        ("strips/[!A]*.las", ["strips/a.las"]),
        ("strips/?.las", ["strips/a.las"]),
        ("o[[]1].las", ["o[1].las"]),
        ("*.las", ["o[1].las"]),
        ("none/*.las", []),
    ],
)
def test_patterns_mean_what_they_mean_on_a_disk(survey: Url, pattern: str, found: list[str]) -> None:
    made = find_remote(pattern, survey, quick())
    assert sorted(str(one.url).removeprefix(f"{survey}/") for one in made) == found


def test_a_file_comes_with_what_belongs_to_it_and_only_once(s3: Server, survey: Url) -> None:
    [strip] = find_remote("strips/a.las", survey, quick())
    assert [name for name, _, _ in strip.held] == ["a.las", "a.wdp"]
    path = local(strip)
    assert (path.read_text(), path.with_suffix(".wdp").read_text()) == ("strips/a.las", "strips/a.wdp")
    s3.faults.seen.clear()
    assert local(strip) == path
    assert not s3.faults.seen
    assert (strip.name, strip.stem) == ("a.las", "a")


def test_a_directory_comes_whole(s3: Server, survey: Url) -> None:
    model = directory_outside(survey / "strips", quick())
    assert sorted(p.name for p in local(model).iterdir()) == ["A2.LAS", "a.las", "a.txt", "a.wdp", "deep"]


@pytest.mark.faults
def test_a_file_that_changes_under_the_run_stops_its_part(s3: Server, survey: Url) -> None:
    [strip] = find_remote("strips/a.las", survey, quick())
    s3.write(survey / "strips/a.las", b"redelivered!")  # as many bytes
    with pytest.raises(InputError, match=r"changed or removed while the run"):
        local(strip)
    s3.remove(survey / "strips/a.las")
    with pytest.raises(InputError, match=r"changed or removed while the run"):
        local(strip)


@pytest.mark.faults
@pytest.mark.parametrize("kind", ["heedless", ""])
def test_a_large_file_that_changes_between_its_pieces_is_no_mixture(s3: Server, kind: str) -> None:
    """A server that does not heed which version was asked for gave pieces of both, and they were believed."""
    url = s3.url("survey")
    old, new = (bytes([k]) * (11 << 20) for k in (1, 2))
    s3.write(url / "a.las", old)
    [strip] = find_remote("a.las", url, quick(chunk_mib=5, parallel=1))
    pieces = itertools.count(1)

    def meant(method: str, path: str) -> bool:
        if method == "GET" and path.endswith("a.las") and next(pieces) == 2:
            s3.write(url / "a.las", new)
        return method == "GET"

    with s3.trouble(Trouble(kind, 100, meant)), pytest.raises(InputError, match="changed or removed while the run"):
        local(strip)


def test_a_file_with_other_bytes_than_planned_stops_its_part(survey: Url) -> None:
    [strip] = find_remote("strips/a.las", survey, quick())
    with pytest.raises(InputError, match=r"changed or removed while the run"):
        local(strip, {"a.las": "0" * 32})
    digest = file_digest(local(strip))
    assert file_digest(local(strip, {"a.las": digest})) == digest
