"""Object storage as it is talked to: conditions, faults of the server and of the network, words for the user."""

from __future__ import annotations

from pathlib import Path

import pytest
from objectstore import Server, Trouble, quick

from fwclass.errors import ConfigError, StoreError
from fwclass.store.objects import Download, Mark, Objects
from fwclass.store.refusals import LostRace
from fwclass.store.url import Url, url_of


@pytest.fixture
def objects(s3: Server) -> Objects:
    return Objects(s3.url("a b/run"), quick())


def test_what_is_put_is_got_listed_copied_and_deleted(objects: Objects, tmp_path: Path) -> None:
    objects.put("x/one #1", b"1")
    (tmp_path / "large").write_bytes(bytes(range(256)) * 40_000 + b"end")  # more than one piece
    objects.put_files({"x/two": tmp_path / "large"})
    objects.copy("x/two", "y/two")
    sizes = {held.key: held.size for held in objects.list()}
    assert sizes == {"x/one #1": 1, "x/two": 10_240_003, "y/two": 10_240_003}
    objects.fetch([Download("y/two", 10_240_003, tmp_path / "back"), Download("x/one #1", 1, tmp_path / "one")])
    assert (tmp_path / "back").read_bytes() == (tmp_path / "large").read_bytes()
    assert (tmp_path / "one").read_bytes() == b"1"
    objects.delete(["x/two", "y/two", "never there"])
    assert [held.key for held in objects.list("x")] == ["x/one #1"]
    assert objects.get("x/two") is None


def test_a_conditional_write_is_won_once(objects: Objects) -> None:
    first = objects.put_new("lock", b"a")
    with pytest.raises(LostRace):
        objects.put_new("lock", b"b")
    second = objects.put_over("lock", b"b", first)
    for mark in (first, Mark('"none"')):
        with pytest.raises(LostRace):
            objects.put_over("lock", b"c", mark)
    assert objects.get("lock") == (b"b", second)
    with pytest.raises(LostRace):
        objects.put_over("gone", b"c", first)


@pytest.mark.faults
def test_a_conditional_write_whose_answer_is_lost_is_still_won(s3: Server, objects: Objects) -> None:
    def put(method: str, path: str) -> bool:
        return method == "PUT"

    with s3.trouble(Trouble("deaf", 1, put)):
        mark = objects.put_new("receipt", b"mine")
    with s3.trouble(Trouble("deaf", 1, put)):
        objects.put_over("receipt", b"mine too", mark)
    assert objects.get("receipt")[0] == b"mine too"


@pytest.mark.faults
@pytest.mark.parametrize("kind", ["busy", "torn", "slow"])
def test_a_server_in_trouble_for_a_while_is_waited_for(s3: Server, objects: Objects, kind: str, tmp_path: Path) -> None:
    data = bytes(range(256)) * 100
    with s3.trouble(Trouble(kind, 7, seconds=0.1)):
        objects.put("a", data)
        assert objects.get("a")[0] == data
        assert [held.key for held in objects.list()] == ["a"]
        objects.fetch([Download("a", len(data), tmp_path / "a")])
    assert (tmp_path / "a").read_bytes() == data


@pytest.mark.faults
def test_a_server_that_stays_in_trouble_is_named(s3: Server) -> None:
    url = s3.url()
    objects = Objects(url, quick(patience=0.5))
    with s3.trouble(Trouble("busy", 10_000)), pytest.raises(StoreError, match=r"does not answer as it should") as told:
        objects.put("a", b"1")
    assert f"{url}/a" in str(told.value)
    assert "503" in str(told.value)
    assert "AWS_ENDPOINT_URL" in str(told.value)


@pytest.mark.parametrize("key", ["run/\x1b[31m/receipt.json", "run//x"])
def test_an_object_of_a_name_that_no_run_gives_is_told(s3: Server, key: str) -> None:
    url = s3.url()
    s3.client.put_object(Bucket=url.split("/")[2], Key=key, Body=b"x")
    with pytest.raises(StoreError, match="an object with a name that no run gives") as told:
        list(Objects(url, quick(patience=0.2)).list())
    assert "\x1b" not in str(told.value) and "remove it" in str(told.value)


@pytest.mark.faults
def test_a_request_that_hangs_is_given_up(s3: Server) -> None:
    objects = Objects(s3.url(), quick(timeout=0.3, patience=0.5))
    with s3.trouble(Trouble("slow", 100, seconds=1.5)), pytest.raises(StoreError, match="does not answer"):
        objects.get("a")


def test_the_user_is_told_of_a_bucket_that_is_not_there(s3: Server) -> None:
    objects = Objects(Url("s3://no-such-bucket-here/run"), quick())
    for ask in (lambda: objects.get("a"), lambda: list(objects.list()), lambda: objects.put_new("a", b"")):
        with pytest.raises(StoreError, match="no such bucket"):
            ask()


def test_the_user_is_told_of_missing_credentials(s3: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_METADATA_ENDPOINT", "http://169.254.169.254:1")
    with pytest.raises(StoreError, match=r"needs credentials[\s\S]*AWS_ACCESS_KEY_ID"):
        Objects(Url("s3://bucket-of-mine/run"), quick(patience=0.2, timeout=0.2)).get("a")


@pytest.mark.parametrize("name", ["AWS_ACCESS_KEY_ID", "AWS_SESSION_TOKEN"])
def test_a_credential_with_the_end_of_a_line_is_refused_and_not_shown(
    name: str, s3: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The library panicked, with a traceback."""
    monkeypatch.setenv(name, "hush\r\n")
    with pytest.raises(ConfigError, match=f"cannot be seen[\\s\\S]*{name}") as told:
        Objects(s3.url(), quick()).get("a")
    assert "hush" not in str(told.value)


@pytest.mark.parametrize("text", ["s3://me:hush@bucket/run", "s3://me@bucket/run", "abfss://me:hush@account/run"])
def test_an_address_with_a_key_is_refused_and_not_shown(text: str) -> None:
    """`run` told it, with the key, where the history could not be written."""
    with pytest.raises(ConfigError, match="no user and no key") as told:
        url_of(text, "--out")
    assert "hush" not in str(told.value)
    assert url_of("abfss://files@account.dfs.core.windows.net/run", "--out")


@pytest.mark.parametrize("text", ["ftp://host/x", "s3://", "s3://bucket/../x", "http://host/x"])
def test_an_address_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="no place on object storage"):
        url_of(text, "--out")


def test_an_address_has_one_spelling() -> None:
    assert url_of("s3://bucket//a/b/", "--out") == Url("s3://bucket/a/b") == Url("s3://bucket") / "a" / "b"
    assert (Url("s3://bucket/a/b").name, Url("s3://bucket/a/b").parent) == ("b", "s3://bucket/a")
