"""No name from outside leads out of the directory that it belongs to."""

from __future__ import annotations

import contextlib
import glob
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from commandline import fwclass
from smallsurvey import small_survey

from fwclass import conf, paths
from fwclass.errors import ConfigError, InputError, StoreError
from fwclass.graph.street import recordings_of
from fwclass.operate.request import Request
from fwclass.paths import below, path_matches
from fwclass.run.logs import log_attempt, remove_logs
from fwclass.store.atomic import file_digest, read_json
from fwclass.store.corrections import WRITING, check_writable
from fwclass.store.directory import Directory, _size
from fwclass.store.history import append as append_history
from fwclass.store.history import lines as history_lines
from fwclass.store.lock import SCHEDULE, WRITER, holder, writer
from fwclass.store.run_location import unmade_again
from fwclass.store.run_store import Store
from fwclass.survey import reference
from fwclass.survey.files import matching_files
from fwclass.survey.gather import require_distinct

NAMES = [
    "..",
    ".",
    "",
    "../x",
    "a/../../x",
    "/etc/x",
    "a//b",
    "a/./b",
    "a\nb",
    "a\x1b[31mb",
    "a\u202eb",
    "a\\b",
    "a\x00b",
    "a" * 201,
    "é" * 150,
]


@pytest.mark.parametrize("name", NAMES)
def test_a_name_that_leads_elsewhere_is_no_name(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="leads out") as fault:
        below(tmp_path, name)
    assert "\x1b" not in str(fault.value) and "\u202e" not in str(fault.value)


@pytest.mark.parametrize("name", ["a", "laz/tiles/1_2.laz", "Straße 7 (neu).laz", "..a", "a..", ".hidden", "漢字"])
def test_names_that_people_give_are_names(name: str, tmp_path: Path) -> None:
    assert below(tmp_path, name) == tmp_path / name


def test_a_link_below_the_directory_leads_nowhere_else(tmp_path: Path) -> None:
    inside, outside = tmp_path / "in", tmp_path / "out"
    inside.mkdir()
    outside.mkdir()
    (inside / "laz").symlink_to(outside)
    (inside / "own").mkdir()
    (inside / "alias").symlink_to(inside / "own")
    with pytest.raises(InputError, match="a link on the way leads to"):
        below(inside, "laz/a.laz")
    assert below(inside, "alias/a.laz").parent.resolve() == inside / "own"
    (tmp_path / "entry").symlink_to(inside)  # the directory itself may be reached by a link
    assert below(tmp_path / "entry", "own/a.laz").is_relative_to(tmp_path / "entry")


@pytest.mark.parametrize("links", [True, False])
def test_where_no_link_is_on_the_way_nothing_need_be_resolved(
    links: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The short way says what the long one says."""
    root = tmp_path / "in"
    for name in ("own/deep", "../out"):
        (root / name).mkdir(parents=True)
    (root / "file").touch()
    for name, target in {"away": "../out", "alias": "own", "ring": "ring", "own/back": "..", "gone": "none"}.items():
        (root / name).symlink_to(target)
    (tmp_path / "entry").symlink_to(root)

    def said(at: Path, name: str) -> object:
        try:
            return below(at, name, links)
        except InputError as fault:
            return str(fault)

    names = ["a", "own/a", "own/deep/a", "none/a/b", "file/a", "away/a", "alias/a", "alias/deep/a", "ring/a", "gone/a"]
    places = [(at, name) for at in (root, tmp_path / "entry", tmp_path / "none") for name in (*names, "own/back/a")]
    short = [said(*place) for place in places]
    monkeypatch.setattr(paths, "_links_below", lambda directory, name: True)
    assert short == [said(*place) for place in places]


@pytest.mark.parametrize("hidden", [False, True])
def test_patterns_of_many_stars_take_steps_in_proportion(hidden: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Six to twelve ``**`` took 0.2 to 47 s; steps are counted."""
    steps: list[str] = []
    fits = paths._fits
    monkeypatch.setattr(paths, "_fits", lambda part, pattern: bool(steps.append(part)) or fits(part, pattern))
    parts, pattern = ["d"] * 30 + ["a.txt"], ["**", "d"] * 20 + ["**", "*.las"]
    assert not path_matches(parts, pattern, hidden) and len(steps) <= len(parts) * (len(pattern) + 1)
    assert path_matches([*parts[:-1], "a.las"], pattern, hidden)


TREE = ("a.las", "x/a.las", "x/y/b.las", "x/y/z/c.LAS", ".h/d.las", "x/.h/e.las", "x/y/[1].las", "x/..a/f.las")


@pytest.mark.parametrize(
    "pattern",
    [
        "**/*.las",
        "**/**/*.las",
        "x/**/*.las",
        "**/y/**/*.las",
        "**/y/*.[lL][aA][sS]",
        "**/.h/*.las",
        "*/**/b.las",
        "**/[[]1].las",
        "**",
        "x/**",
        "../s/**/*.las",
        "**/x/../*.las",
        "*.las",
        "none/**/*.las",
    ],
)
def test_patterns_find_what_glob_finds(pattern: str, tmp_path: Path) -> None:
    root = tmp_path / "s"
    for name in TREE:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()
    there = glob.glob(f"{root}/{pattern}", recursive=True)  # noqa: PTH207 - what surveys were found by
    wanted = sorted({Path(p) for p in there if Path(p).is_file()})
    assert sorted(matching_files(pattern, root)) == wanted


def test_links_that_lead_back_are_walked_once(tmp_path: Path) -> None:
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "a.las").touch()
    for name in "bcdefgh":
        (tmp_path / "d" / name).symlink_to(tmp_path)
    found = matching_files("**/*.las", tmp_path)
    assert found == [tmp_path / "d" / "a.las"]


@pytest.mark.parametrize("pattern", ["*/*.las", "**/*.las", "d/*.las"])
def test_a_directory_that_may_not_be_read_is_named(
    pattern: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("c", "d", ".e", "lost+found"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.las").touch()
    readable = os.access
    closed = {"d", ".e", "lost+found"}  # root may read all
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path).name not in closed and readable(path, mode))
    with pytest.raises(InputError, match="cannot be read") as told:
        matching_files(pattern, tmp_path)
    assert str(tmp_path / "d") in str(told.value)
    closed.remove("d")
    assert tmp_path / "d" / "a.las" in matching_files(pattern, tmp_path)


def test_a_directory_of_recordings_that_may_not_be_read_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("c", "d"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.parquet").touch()
    (tmp_path / "c" / "bag").mkdir()
    config = conf.load("street-sim", (f"survey.directory={tmp_path}", "survey.sources=['*/*']"))
    every = [tmp_path / "c" / "a.parquet", tmp_path / "c" / "bag", tmp_path / "d" / "a.parquet"]
    assert recordings_of(config) == every
    readable = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path).name != "d" and readable(path, mode))
    with pytest.raises(InputError, match="cannot be read"):
        recordings_of(config)


def committed(root: Path) -> tuple[Store, Path]:
    """A store with one delivered part, and its receipt."""

    def work(directory: Path) -> dict[str, int]:
        (directory / "survey").mkdir()
        (directory / "survey" / "a.las").write_text("abc")
        return {}

    store = Store(root)
    store.commit("simulate", "one", "k1", {}, "run", work)
    return store, root / "store" / "simulate" / "one" / "receipt.json"


HOSTILE = {
    "outputs": [{name: {"bytes": 1, "digest": "0"}} for name in ("../victim", "/etc/passwd", "a/../../victim", "..")],
    "part": ["..", "../..", "other", "", 7, "one\n"],
    "stage": ["..", "../..", "other", None],
    "key": ["../../victim", "", 3],
    "params": ["../../victim"],
    "digest": ["../x", None],
    "place": ["elsewhere", None],
    "meta": [[]],
    "inputs": ["x"],
}


@pytest.mark.parametrize(("field", "value"), [(f, v) for f, values in HOSTILE.items() for v in values])
def test_a_receipt_that_was_tampered_with_deletes_nothing(field: str, value: object, tmp_path: Path) -> None:
    root = tmp_path / "run"
    victim = tmp_path / "victim"
    victim.write_text("dear")
    store, path = committed(root)
    told = {**json.loads(path.read_text()), field: value}
    del told["seal"]  # with it the receipt would only say nothing
    path.write_text(json.dumps(told))
    for use in (
        lambda: store.forget_others("simulate", []),
        lambda: store.done("simulate", "one", "k1"),
        lambda: store.path("simulate", "one", "a"),
        lambda: list(store.receipts("simulate")),
    ):
        with pytest.raises(StoreError) as fault:
            use()
        assert str(path) in str(fault.value)
    assert victim.read_text() == "dear" and (root / "survey" / "a.las").exists()


def test_a_delivery_does_not_follow_a_link_out_of_the_run(tmp_path: Path) -> None:
    root, outside = tmp_path / "run", tmp_path / "out"
    outside.mkdir()
    root.mkdir()
    (root / "survey").symlink_to(outside)
    with pytest.raises(InputError, match="a link on the way leads to"):
        committed(root)
    assert list(outside.iterdir()) == []


def test_collecting_does_not_follow_a_link_out_of_the_run(tmp_path: Path) -> None:
    root, outside = tmp_path / "run", tmp_path / "out"
    store, _ = committed(root)
    (root / "survey").rename(outside)
    (root / "survey").symlink_to(outside)
    with pytest.raises(InputError, match="a link on the way leads to"):
        store.forget_others("simulate", [])
    assert (outside / "a.las").exists()


@pytest.mark.parametrize("where", ["out", "run/labels"])
@pytest.mark.parametrize("name", ["store/simulate", "store/simulate/1_2"])
def test_a_part_is_not_moved_through_a_link(name: str, where: str, tmp_path: Path) -> None:
    """Its receipt was refused, its files lay there by then, in place of what had that name."""
    root, outside = tmp_path / "run", tmp_path / where
    for kept in ("1_2/k1/mine", "k1/mine"):
        (outside / kept).parent.mkdir(parents=True)
        (outside / kept).write_text("dear")
    (root / name).parent.mkdir(parents=True)
    (root / name).symlink_to(outside)

    def work(directory: Path) -> dict[str, int]:
        (directory / "table").write_text("abc")
        return {}

    with pytest.raises(InputError, match="a link on the way leads to"):
        Store(root).commit("simulate", "1_2", "k1", {}, "store", work)
    assert sorted(p.name for p in outside.rglob("*") if p.is_file()) == ["mine", "mine"]


@pytest.mark.parametrize("part", ["..", "a/b", "../../x", "a\n", ""])
def test_a_part_has_a_name_of_its_own(part: str, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="cannot be the name of a part"):
        Store(tmp_path).receipt("tile", part)


@pytest.mark.parametrize("place", ["store", "store/x/y", "current/laz", "generations"])
def test_no_run_is_made_in_what_another_has_made(place: str, tmp_path: Path) -> None:
    for name in ("store", "generations/0001/laz"):
        (tmp_path / "r" / name).mkdir(parents=True)
    (tmp_path / "r" / "current").symlink_to("generations/0001")
    with pytest.raises(ConfigError, match="what another run has made"), unmade_again(tmp_path / "r" / place / "new"):
        (tmp_path / "r" / place / "new").mkdir(parents=True)
    assert not (tmp_path / "r" / place / "new").exists()
    with unmade_again(tmp_path / "r" / "beside"):
        pass


@pytest.mark.parametrize("place", ["store", "generations", "generations/0001", "current", "current/laz"])
def test_no_run_is_made_in_a_directory_of_another(place: str, tmp_path: Path) -> None:
    """`--out RUN/current` left a store in the delivery."""
    for name in ("store", "generations/0001/laz"):
        (tmp_path / "r" / name).mkdir(parents=True)
    (tmp_path / "r" / "current").symlink_to("generations/0001")
    before = sorted(tmp_path.rglob("*"))
    survey = small_survey(tmp_path)
    for line in (("run", survey, "--workers", 0), ("schedule", survey, "--every", "3s", "--once")):
        ended = fwclass(*line, "--out", tmp_path / "r" / place)
        assert ended.returncode == 2 and "what another run has made" in ended.stderr, ended.stderr
    assert sorted(p for p in tmp_path.rglob("*") if p.suffix not in (".las", ".yaml")) == before


def test_a_pending_delivery_that_is_a_link_is_not_written_through(tmp_path: Path) -> None:
    outside = tmp_path / "out"
    outside.mkdir()
    (outside / "mine").write_text("dear")
    generations = tmp_path / "run" / "generations"
    generations.mkdir(parents=True)
    (generations / ".pending").symlink_to(outside)
    pending = Store(tmp_path / "run").generations.pending
    assert not pending.is_symlink() and pending.is_dir()
    assert (outside / "mine").read_text() == "dear"


@pytest.mark.parametrize("stem", ["..", "a\nb", "a\x1b[31m", "a\u202eb", "a\\b", "a" * 240])
def test_a_source_file_with_such_a_name_is_refused(stem: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no output can have") as fault:
        require_distinct([tmp_path / "good.las", tmp_path / f"{stem}.las"])
    assert "\x1b" not in str(fault.value) and "\u202e" not in str(fault.value)


def test_the_words_of_a_run_are_quoted_in_the_command_that_replays_it(tmp_path: Path) -> None:
    Request("x; rm -rf /", str(tmp_path), ("a=$(id)",), tiles=("`id`",)).keep(Store(tmp_path))
    told = Request.kept(Store(tmp_path)).command()
    assert "'x; rm -rf /'" in told and "'a=$(id)'" in told and "'`id`'" in told


@pytest.mark.parametrize("name", ["generations", "store/staging", "store/params"])
def test_cleaning_does_not_follow_a_link_out_of_the_run(name: str, tmp_path: Path) -> None:
    root, outside = tmp_path / "run", tmp_path / "out"
    store, _ = committed(root)
    (outside / "0000").mkdir(parents=True)
    (outside / ".mine").write_text("dear")
    shutil.rmtree(root / name, ignore_errors=True)
    (root / name).parent.mkdir(exist_ok=True)
    (root / name).symlink_to(outside)
    with pytest.raises(InputError, match="a link on the way leads to"):
        store.generations.files.retire(["0000"]) if name == "generations" else store.clear_staging()
    assert {p.name for p in outside.iterdir()} == {"0000", ".mine"}


@pytest.mark.parametrize("name", ["store", "generations"])
def test_a_run_whose_parts_would_lie_elsewhere_is_refused_at_once(name: str, tmp_path: Path) -> None:
    run, disk = tmp_path / "run", tmp_path / "disk"
    run.mkdir()
    disk.mkdir()
    (run / name).symlink_to(disk)
    with pytest.raises(StoreError, match="put the whole run directory there"):
        Store(run).generations.check_links()
    assert list(disk.iterdir()) == []


LINKED = [f"store/{name}" for name in ("lock", "schedule.lock", "corrections.lock", "history.lock", "history.jsonl")]


@pytest.mark.parametrize("name", [*LINKED, "logs/tile/1_2.log"])
def test_what_is_held_or_appended_to_is_no_link(name: str, tmp_path: Path) -> None:
    """A lock empties its file: a link in an unpacked run directory emptied whatever it led to; a log added lines."""
    root, victim = tmp_path / "run", tmp_path / "victim"
    victim.write_text("dear")
    (root / name).parent.mkdir(parents=True)
    (root / name).symlink_to(victim)
    using(root, name)
    assert victim.read_text() == "dear" and (root / name).is_symlink()
    victim.unlink()
    using(root, name)
    assert not victim.exists()


def using(root: Path, name: str) -> None:
    """Do what writes to `name`; told, or left."""
    locks = {lock.name: lock for lock in (WRITER, SCHEDULE, WRITING)}
    if name.startswith("logs"):
        log_attempt(root, "tile", "1_2", {"status": "failed", "message": "`touch x`"})
        return
    with pytest.raises(InputError, match="no file of the directory itself"):
        if name.rpartition("/")[2] in locks:
            with writer(root, locks[name.rpartition("/")[2]]):
                pass
        else:
            append_history(root, {"when": "2026"})


@pytest.mark.parametrize("name", ["store", "store/staging", "store/failures", "labels", "logs"])
def test_nothing_is_written_or_removed_through_a_directory_that_is_a_link(name: str, tmp_path: Path) -> None:
    root, outside = tmp_path / "run", tmp_path / "out"
    (outside / "tile").mkdir(parents=True)
    for kept in ("tile/1_2.json", "tile/1_2.log", "lock"):
        (outside / kept).write_text("dear")
    (root / name).parent.mkdir(parents=True)
    (root / name).symlink_to(outside)
    files = Directory(root)
    uses: list[Callable[[], object]] = [
        lambda: files.put("store/failures/tile/1_2.json", "{}"),
        lambda: files.delete(["store/failures/tile/1_2.json"]),
        lambda: files.making("tile", "1_2").__enter__(),
        lambda: writer(root).__enter__(),
        lambda: check_writable(root),
        lambda: log_attempt(root, "tile", "1_2", {"status": "done"}),
        lambda: remove_logs(root, [("tile", "1_2")]),
        lambda: reference._copied(Path(__file__), b"", Store(root)),
    ]
    for use in uses:
        with contextlib.suppress(InputError):
            use()
    assert sorted(p.relative_to(outside).as_posix() for p in outside.rglob("*")) == [
        "lock",
        "tile",
        "tile/1_2.json",
        "tile/1_2.log",
    ]
    assert {p.read_text() for p in outside.rglob("*") if p.is_file()} == {"dear"}


def test_a_pipe_in_the_place_of_a_lock_keeps_nobody_waiting(tmp_path: Path) -> None:
    (tmp_path / "store").mkdir()
    os.mkfifo(tmp_path / "store" / WRITER.name)
    for use in (lambda: holder(tmp_path), lambda: writer(tmp_path).__enter__()):
        with pytest.raises(InputError, match="this is no file"):
            use()


@pytest.mark.parametrize("name", ["generations/0001", "store/staging", "store/staging/killed", "store/tile/1_2"])
def test_a_pipe_in_the_place_of_a_directory_that_is_removed_keeps_nobody_waiting(name: str, tmp_path: Path) -> None:
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    os.mkfifo(tmp_path / name)
    files = Directory(tmp_path)
    uses: dict[str, Callable[[], object]] = {
        "generations/0001": lambda: files.retire(["0001"]),
        "store/tile/1_2": lambda: files.delete_below("store/tile/1_2", "receipt.json"),
    }
    with contextlib.suppress(NotADirectoryError):
        uses.get(name, files.sweep)()
    assert name == "store/staging/killed" or (tmp_path / name).is_fifo()  # what a killed worker left goes with the rest


@pytest.mark.parametrize(
    "name", ["store/run.json", "store/tile/1_2/receipt.json", "store/history.jsonl", "manifest.json"]
)
def test_a_pipe_in_the_place_of_what_a_run_has_noted_keeps_nobody_waiting(name: str, tmp_path: Path) -> None:
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    os.mkfifo(tmp_path / name)
    uses: dict[str, Callable[[], object]] = {
        "store/history.jsonl": lambda: list(history_lines(tmp_path)),
        "manifest.json": lambda: (read_json(tmp_path / name), file_digest(tmp_path / name)),
    }
    with pytest.raises(InputError, match="this is no file"):
        uses.get(name, lambda: Directory(tmp_path).get(name))()


def test_links_in_a_ring_are_told_in_words(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "store").symlink_to("store")
    with contextlib.suppress(InputError):
        below(tmp_path / "run", "store/x")
    Directory(tmp_path / "run")
    assert _size(str(tmp_path / "run" / "store")) is None
    for words in (("status", "run/store"), ("status", "run"), ("history", "run"), ("clean", "run", "--keep", "latest")):
        ended = fwclass(*words, cwd=tmp_path)
        assert ended.returncode in (1, 2) and ended.stderr.startswith(("fwclass: ", "Usage: ")), ended.stderr
