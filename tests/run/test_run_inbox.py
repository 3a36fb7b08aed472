"""What an inbox takes for complete, and how it goes into the survey."""

from __future__ import annotations

import glob
import os
import shutil
from dataclasses import dataclass, field
from pathlib import Path

import lasmaker
import pytest

from fwclass import conf
from fwclass.errors import ConfigError
from fwclass.operate.schedule.delivery import take
from fwclass.operate.schedule.inbox import Inbox
from fwclass.operate.schedule.source_directories import SourceDirectories, source_directories_of
from fwclass.operate.schedule.ticks import Now
from fwclass.paths import path_matches


@dataclass
class Post:
    """An inbox of a survey `survey` with the sources `strips/*.la[sz]`, looked at by a clock of its own."""

    root: Path
    params: object = None
    inbox: Inbox = field(init=False)
    clock: float = 0.0

    def __post_init__(self) -> None:
        (self.root / "inbox").mkdir()
        patterns = tuple(str(self.root / "survey" / "strips" / f"*{end}") for end in (".las", ".laz", ".pls"))
        self.inbox = Inbox(self.root / "inbox", SourceDirectories(patterns, None), self.params)

    @property
    def strips(self) -> Path:
        return self.root / "survey" / "strips"

    def later(self, seconds: float):
        self.clock += seconds
        return self.inbox.look(Now(0.0, self.clock))

    def why(self, look, name: str) -> str:
        [found] = [w.why for w in look.waiting if w.name == name]
        return found

    def take(self, look, keep: int = 3):
        return [take(d, self.inbox.directory, self.inbox.sources, keep) for d in look.complete]


@pytest.fixture
def post(tmp_path):
    def make(*settings: str) -> Post:
        return Post(tmp_path, conf.section("schedule", ("schedule.settle=10", *settings)))

    return make


def whole(directory: Path, name: str = "a.las", **options) -> bytes:
    """A strip with waveforms beside it; its bytes."""
    return lasmaker.survey(directory / name, pulses=20, **options).path.read_bytes()


def test_a_growing_file_is_waited_for(post, tmp_path):
    """Written in pieces, with its header first: it is complete when it stops and is as long as the header says."""
    box = post()
    content = whole(tmp_path, "b.las", point_format=6)
    path = box.inbox.directory / "a.las"
    for share in (0.2, 0.5, 0.9):
        path.write_bytes(content[: int(share * len(content))])
        assert "not stayed unchanged" in box.why(box.later(9.0), "a.las")
    look = box.later(10.0)
    assert not look.complete and "cut short" in box.why(look, "a.las") and not look.waiting[0].changing
    path.write_bytes(content)
    assert not box.later(1.0).complete
    assert not box.later(9.0).complete
    look = box.later(1.0)
    assert [d.name for d in look.complete] == ["a.las"] and not look.waiting


def test_compressed_waveforms_must_be_whole(post):
    """A `.wdz` states no length: the last points' packets must lie in it."""
    box = post()
    packed = {1: lasmaker.Descriptor(bits=8, compression=1)}
    whole(box.inbox.directory, descriptors=packed)
    waves = box.inbox.directory / "a.wdz"
    packets = waves.read_bytes()
    waves.write_bytes(packets[: len(packets) // 2])
    box.later(0.0)
    assert "a.wdz is cut short" in box.why(box.later(60.0), "a.las")
    waves.write_bytes(packets)
    box.later(1.0)
    assert box.later(60.0).complete


def test_waveforms_that_nobody_has_written_yet_are_waited_for(post):
    """A file that an upload has given its length."""
    box = post()
    lasmaker.survey(box.inbox.directory / "a.las", pulses=200)
    waves = box.inbox.directory / "a.wdp"
    packets = waves.read_bytes()
    waves.write_bytes(packets[:4000] + bytes(len(packets) - 4000))
    box.later(0.0)
    assert "a.wdp ends in zeros" in box.why(box.later(60.0), "a.las")
    waves.write_bytes(packets)
    box.later(1.0)
    assert box.later(60.0).complete


def test_waveforms_that_end_in_zeros_are_whole_where_a_marker_says_so(post):
    """A receiver that was dark at the end of a strip; without the marker it would wait for ever."""
    box = post()
    lasmaker.survey(box.inbox.directory / "a.las", pulses=200)
    waves = box.inbox.directory / "a.wdp"
    packets = waves.read_bytes()
    waves.write_bytes(packets[:-5000] + bytes(5000))
    box.later(0.0)
    assert "a.wdp ends in zeros" in box.why(box.later(60.0), "a.las")
    (box.inbox.directory / f"a{box.inbox.params.markers[0]}").touch()
    assert [d.name for d in box.later(1.0).complete] == ["a.las"]


def test_the_name_of_an_upload_waits_for_another(tmp_path):
    (tmp_path / "inbox").mkdir()
    box = Inbox(
        tmp_path / "inbox", SourceDirectories((str(tmp_path / "survey" / "*"),), None), conf.section("schedule")
    )
    whole(tmp_path / "inbox", "a.las.part", point_format=6)
    for steady in (0.0, 100.0):
        look = box.look(Now(0.0, steady))
    assert not look.complete and "upload" in look.waiting[0].why


def test_times_that_the_file_carries_prove_nothing(post):
    """`cp -p` and `rsync -t` give a file an old time while, or right after, it is written."""
    box = post()
    whole(box.inbox.directory, point_format=6)
    os.utime(box.inbox.directory / "a.las", (1e9, 1e9))
    assert not box.later(0.0).complete and not box.later(9.0).complete
    assert box.later(1.0).complete


def test_waveforms_must_be_beside_and_whole(post):
    box = post()
    whole(box.inbox.directory)
    waves = box.inbox.directory / "a.wdp"
    packets = waves.read_bytes()
    waves.unlink()
    box.later(0.0)
    assert "put a.wdp beside" in box.why(box.later(10.0), "a.las")
    waves.write_bytes(packets[:-30])
    assert "not stayed unchanged" in box.why(box.later(1.0), "a.las")
    assert "a.wdp is cut short" in box.why(box.later(10.0), "a.las")
    waves.write_bytes(packets)
    box.later(1.0)
    look = box.later(10.0)
    assert [[p.name for p in d.files] for d in look.complete] == [["a.wdp", "a.las"]]
    box.take(look)
    assert sorted(p.name for p in box.strips.iterdir()) == ["a.las", "a.wdp"]
    assert not list(box.inbox.directory.iterdir())


def test_a_header_that_was_not_written_last_is_not_complete(post):
    box = post()
    content = bytearray(whole(box.inbox.directory, point_format=6))
    content[247:255] = (3).to_bytes(8, "little")  # of LAS 1.4: the number of points
    (box.inbox.directory / "a.las").write_bytes(content)
    box.later(0.0)
    assert "header counts fewer points" in box.why(box.later(10.0), "a.las")
    (box.inbox.directory / "a.las.done").touch()
    assert not box.later(0.0).complete  # whatever who sends it says: the points would be lost


def test_compressed_files_without_their_table_are_not_complete(post, tmp_path):
    box = post()
    whole(tmp_path, "b.las", point_format=6)
    content = lasmaker.to_laz(tmp_path / "b.las", tmp_path / "b.laz").read_bytes()
    path = box.inbox.directory / "a.laz"
    path.write_bytes(content[:-20])
    box.later(0.0)
    assert not box.later(10.0).complete
    path.write_bytes(content)
    box.later(0.0)
    assert box.later(10.0).complete


def test_internal_waveforms_must_be_whole(post):
    box = post()
    content = whole(box.inbox.directory, where="internal")
    path = box.inbox.directory / "a.las"
    for cut in (100, len(content) // 2):
        path.write_bytes(content[:-cut])
        box.later(0.0)
        assert not box.later(10.0).complete, cut
    path.write_bytes(content)
    box.later(0.0)
    assert box.later(10.0).complete


@pytest.mark.parametrize("marker", ["a.las.done", "a.done", "a.las.complete"])
def test_a_marker_says_that_a_file_is_complete(post, marker):
    box = post("schedule.complete=marker")
    whole(box.inbox.directory, point_format=6)
    box.later(0.0)
    assert "no .done or .complete stands beside it" in box.why(box.later(1e5), "a.las")
    (box.inbox.directory / marker).touch()
    look = box.later(0.0)
    assert look.complete
    box.take(look)
    assert not list(box.inbox.directory.iterdir())


def test_a_marker_beside_half_a_file_is_not_believed(post):
    box = post("schedule.complete=marker")
    content = whole(box.inbox.directory, point_format=6)
    (box.inbox.directory / "a.las").write_bytes(content[:-200])
    (box.inbox.directory / "a.las.done").touch()
    assert "cut short" in box.why(box.later(0.0), "a.las")


def test_complete_files_wait_for_those_on_their_way_but_not_for_ever(post):
    box = post("schedule.hold=100")
    whole(box.inbox.directory, point_format=6)
    growing = box.inbox.directory / "b.las"
    for k in range(30):
        growing.write_bytes(b"LASF" + bytes(k))
        look = box.later(5.0)
        ready = box.inbox.ready(look, Now(0.0, box.clock))
        assert bool(look.complete) == (box.clock >= 15.0)
        assert bool(ready) == (box.clock >= 115.0), box.clock


def test_a_delivery_again_keeps_the_older_one_and_says_so(post):
    box = post()
    contents = []
    for seed in range(4):
        contents.append(whole(box.inbox.directory, seed=seed))
        box.later(0.0)
        [facts] = box.take(box.later(10.0), keep=2)
        assert (box.strips / "a.las").read_bytes() == contents[-1]
        kept = sorted(p.name for p in (box.inbox.directory / "replaced").glob("*/*"))
        assert kept == sorted(["a.las", "a.wdp"] * min(seed, 2))
        assert len(facts["replaced"]) == (2 if seed else 0)
        for name in facts["replaced"]:
            older = box.inbox.directory / name
            assert older.suffix == ".wdp" or older.read_bytes() == contents[-2]


def test_a_delivery_again_replaces_the_older_one_where_that_lies(tmp_path):
    inbox = Inbox(tmp_path / "inbox", SourceDirectories((str(tmp_path / "survey" / "**" / "*.las"),), None), None)
    inbox.directory.mkdir()
    for name in ("day1/a.las", "day1/b.las", "day2/b.las"):
        path = tmp_path / "survey" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    whole_place = tmp_path / "survey"
    assert inbox.sources.home("a.laz", whole_place) == tmp_path / "survey" / "day1"
    assert inbox.sources.home("A.las", whole_place) == tmp_path / "survey" / "day1"
    assert inbox.sources.home("b.las", whole_place) == whole_place  # which of the two is for a person to say
    assert inbox.sources.home("c.las", whole_place) == whole_place


def test_links_below_replaced_are_not_followed(post, tmp_path):
    """Files elsewhere were removed as older versions, and older versions written elsewhere."""
    box, elsewhere = post(), tmp_path / "elsewhere"
    elsewhere.mkdir()
    for name in ("a.las", "a.wdp"):
        (elsewhere / name).write_text("mine")
    (box.inbox.directory / "replaced").mkdir()
    for k in range(4):
        (box.inbox.directory / "replaced" / f"2025010{k}T000000Z-0000").symlink_to(elsewhere)
    for seed in range(3):
        whole(box.inbox.directory, seed=seed)
        box.later(0.0)
        box.take(box.later(10.0), keep=1)
    kept = [p for p in (box.inbox.directory / "replaced").iterdir() if not p.is_symlink()]
    assert sorted(p.name for d in kept for p in d.iterdir()) == ["a.las", "a.wdp"]
    shutil.rmtree(box.inbox.directory / "replaced")
    (box.inbox.directory / "replaced").symlink_to(elsewhere)
    whole(box.inbox.directory, seed=4)
    box.later(0.0)
    with pytest.raises(OSError, match="a link stands where replaced files are kept"):
        box.take(box.later(10.0), keep=1)
    assert (box.inbox.directory / "a.las").exists() and (box.strips / "a.las").exists()
    assert sorted(p.name for p in elsewhere.iterdir()) == ["a.las", "a.wdp"]
    assert {p.read_text() for p in elsewhere.iterdir()} == {"mine"}


def test_a_compressed_strip_replaces_the_same_strip_uncompressed(post, tmp_path):
    box = post()
    box.strips.mkdir(parents=True)
    whole(box.strips)  # and its .wdp
    whole(tmp_path, "b.las", point_format=6)
    lasmaker.to_laz(tmp_path / "b.las", box.inbox.directory / "a.laz")
    box.later(0.0)
    box.take(box.later(10.0))
    assert [p.name for p in box.strips.iterdir()] == ["a.laz"]
    assert sorted(p.name for p in (box.inbox.directory / "replaced").glob("*/*")) == ["a.las", "a.wdp"]


def test_a_move_that_was_cut_off_goes_on(post):
    """Killed between the waveforms and the points: the next look takes the points."""
    box = post()
    whole(box.inbox.directory)
    box.strips.mkdir(parents=True)
    (box.inbox.directory / "a.wdp").rename(box.strips / "a.wdp")
    box.later(0.0)
    look = box.later(10.0)
    assert [[p.name for p in d.files] for d in look.complete] == [["a.las"]]
    box.take(look)
    assert sorted(p.name for p in box.strips.iterdir()) == ["a.las", "a.wdp"]
    assert not (box.inbox.directory / "replaced").exists()


def test_to_another_file_system_files_are_copied_whole(post, tmp_path):
    other = Path("/dev/shm")  # noqa: S108 - another file system than that of the tests
    if not other.is_dir() or other.stat().st_dev == tmp_path.stat().st_dev:
        pytest.skip("no second file system")
    box = post()
    place = other / f"fwclass-test-{os.getpid()}"
    try:
        box.inbox.sources = SourceDirectories((str(place / "*.las"),), None)
        content = whole(box.inbox.directory)
        box.later(0.0)
        box.take(box.later(10.0))
        assert sorted(p.name for p in place.iterdir()) == ["a.las", "a.wdp"]
        assert (place / "a.las").read_bytes() == content and not list(box.inbox.directory.iterdir())
    finally:
        for path in place.glob("*"):
            path.unlink()
        place.rmdir()


def test_what_is_no_delivery_stays(post):
    box = post()
    inside = box.inbox.directory
    (inside / "notes.txt").write_text("x")
    (inside / ".a.las.Xy12").write_bytes(b"LASF")
    (inside / "b.wdp").write_bytes(bytes(100))
    (inside / "sub").mkdir()
    whole(box.root, "elsewhere.las", point_format=6)
    (inside / "link.las").symlink_to(box.root / "elsewhere.las")
    box.later(0.0)
    look = box.later(1e6)
    assert not look.complete
    assert {w.name: w.changing for w in look.waiting} == {"notes.txt": False, "b.wdp": False}
    assert "finds no file of this name" in box.why(look, "notes.txt")


def test_an_inbox_keeps_no_memory_of_what_has_gone(post):
    box = post()
    for k in range(50):
        path = box.inbox.directory / f"n{k}.las"
        path.write_bytes(b"LASF")
        box.later(20.0)
        path.unlink()
    box.later(1.0)
    assert not box.inbox._since and not box.inbox._judged


def config_of(tmp_path: Path, sources: str, *settings: str):
    (tmp_path / "c.yaml").write_text(
        f"survey: {{name: s, directory: data, sources: {sources}, reference: {{kind: source}}, crs: none,\n"
        "  classes: [{name: a, code: 2, codes: [2]}, {name: b, code: 6, codes: [6]}]}\n"
        "areas: {train: [[0, 0, 5, 10]]}\n"
    )
    return conf.load(tmp_path / "c.yaml", settings)


@pytest.mark.parametrize(
    ("sources", "name", "place"),
    [
        ('["strips/*.las"]', "a.las", "strips"),
        ('["strips/*.las"]', "a.laz", None),
        ('["east/e*.las", "west/*.las"]', "e1.las", "east"),
        ('["east/e*.las", "west/*.las"]', "w1.las", "west"),
        ('["**/*.las"]', "a.las", ""),
        ('["s[12]/*.las"]', "a.las", None),
        ('["*/*.las", "more/*.laz"]', "a.laz", "more"),
    ],
)
def test_files_go_where_the_survey_finds_them(tmp_path, sources, name, place):
    found = source_directories_of(config_of(tmp_path, sources), tmp_path / "in").of(name)
    assert found == (None if place is None else tmp_path / "data" / place)


def test_a_place_may_be_named_and_must_be_one_of_the_survey(tmp_path):
    config = config_of(tmp_path, '["*/*.las"]', "schedule.into=new")
    assert source_directories_of(config, tmp_path / "in").of("a.las") == tmp_path / "data" / "new"
    config = config_of(tmp_path, '["strips/*.las"]', "schedule.into=new")
    assert source_directories_of(config, tmp_path / "in").of("a.las") is None


def test_an_inbox_where_the_survey_looks_is_refused(tmp_path):
    for sources, inbox in (('["strips/*.las"]', "strips"), ('["**/*.las"]', "in"), ('["*/*.las"]', "in")):
        with pytest.raises(ConfigError, match="where the survey looks"):
            source_directories_of(config_of(tmp_path, sources), tmp_path / "data" / inbox)
    for sources in ('["*/*/*.las"]', '["in/replaced/*/a.las"]', '["in/*/*/*.las"]'):  # nor what it keeps of older files
        with pytest.raises(ConfigError, match="or an older version"):
            source_directories_of(config_of(tmp_path, sources, "schedule.into=y/f"), tmp_path / "data" / "in")
    with pytest.raises(ConfigError, match="simulated"):
        source_directories_of(conf.load("demo"), tmp_path)


def test_patterns_match_as_glob_does(tmp_path):
    for name in ("a.las", "x/a.las", "x/y/a.las", ".h/a.las", "x/.a.las"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    for pattern in ("*.las", "*/*.las", "**/*.las", "x/**/*.las", "x/?/a.las", "[xy]/*", "**/a*", ".h/*"):
        found = set(glob.glob(str(tmp_path / pattern), recursive=True))  # noqa: PTH207 - what surveys are found by
        mine = {
            str(p) for p in tmp_path.rglob("*") if p.is_file() and path_matches(p.parts, (tmp_path / pattern).parts)
        }
        assert mine == {f for f in found if Path(f).is_file()}, pattern


def test_a_name_that_no_strip_can_have_stays_in_the_inbox(post):
    """Once it was moved into the survey, and every run after it failed."""
    box = post()
    evil = "a\n2026-01-01T00:00:00Z schedule: run ended: done.las"
    for name in (evil, "b" * 230 + ".las", "good.las"):
        lasmaker.survey(box.inbox.directory / name, pulses=20, point_format=6)
    box.later(0)
    look = box.later(11)
    assert [d.name for d in look.complete] == ["good.las"]
    assert "cannot be seen" in box.why(look, evil) and "stays here" in box.why(look, evil)
    assert "longer than" in box.why(look, "b" * 230 + ".las")
