"""Progress: a bounded number of plain lines, live bars for a person, no foreign text that moves a terminal."""

import io

import pytest
from rich.console import Console

from fwclass.compiling import ONCE
from fwclass.run.part import Outcome, Task
from fwclass.run.progress import PERIOD, TOLD, Display, span


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def shown(live):
    clock = Clock()
    display = Display(clock)
    display.console = Console(file=io.StringIO(), force_terminal=live, width=100, highlight=False, soft_wrap=True)
    display._live = live
    display._bars.live.console = display.console
    return display, clock


def task(stage, n):
    return Task(stage, f"{n}", 1, {}, lambda inputs, directory: {})


def test_many_parts_are_few_lines():
    display, clock = shown(live=False)
    display.expect({"features": 100_000})
    for n in range(100_000):
        clock.now += 0.01
        failed = n % 1000 == 999
        display.ended(
            Outcome("features", f"{n}", "failed" if failed else "computed", message="no oil" if failed else "")
        )
    rows = display.console.file.getvalue().splitlines()
    between = [r for r in rows if " of 100000, " in r]
    assert len(between) == pytest.approx(1000 / PERIOD, abs=2)
    assert "100.0/s, 8 min left, 50 failed" in between[len(between) // 2 - 1] or "/s, " in between[0]
    assert rows[-1] == "features         99900 computed, 100 failed"
    assert sum(r.startswith("FAILED features/") for r in rows) == TOLD
    assert len(rows) < TOLD + 1000 / PERIOD + 5


def test_what_was_done_before_does_not_count_as_pace():
    display, clock = shown(live=False)
    display.expect({"tile": 1000})
    for n in range(500):
        display.ended(Outcome("tile", f"{n}", "skipped"))
    for n in range(500, 600):
        clock.now += 10.0
        display.ended(Outcome("tile", f"{n}", "computed", seconds=10.0))
    last = display.console.file.getvalue().splitlines()[-1]
    assert last.startswith("tile             ") and "6.0/min" in last and " min left" in last


def test_workers_at_another_stage_do_not_make_this_one_slow():
    """Four of 7 851 parts had been made in half a minute beside another stage: 17 h were told for some minutes."""
    display, clock = shown(live=False)
    display.workers = 2
    display.expect({"contours": 7851})
    for n in range(4):
        clock.now += PERIOD / 3
        display.ended(Outcome("contours", f"{n}", "computed", seconds=0.05))
    (line,) = [r for r in display.console.file.getvalue().splitlines() if r.startswith("contours")]
    assert line.endswith("of 7851, 40.0/s, 3 min left"), line


def test_a_person_sees_bars_of_what_is_under_way():
    display, _ = shown(live=True)
    display.workers = 4
    with display:
        display.expect({"read": 1, "tile": 3})
        display.ended(Outcome("read", "1", "computed"))
        display.ended(Outcome("tile", "1", "failed", message="bad\x1b[2J file\nsecond line"))
        display._bars.refresh()
        bars = {t.description: t for t in display._bars.tasks}
        assert set(bars) == {"all", "read", "tile"}
        assert (bars["all"].completed, bars["all"].total, bars["all"].fields["pace"]) == (2, 4, "4 workers")
        assert not bars["read"].visible and bars["tile"].visible
        assert (bars["tile"].completed, bars["tile"].total) == (1, 3) and "1 failed" in bars["tile"].fields["pace"]
    text = display.console.file.getvalue()
    assert "read             1 computed" in text and "FAILED tile/1: bad\\x1b[2J file\nsecond line" in text


def test_spans_in_words():
    assert [span(s) for s in (3.2, 98, 100, 3590, 3660)] == ["3 s", "98 s", "2 min", "1 h 00 min", "1 h 01 min"]


@pytest.mark.parametrize("live", [False, True])
def test_compiling_is_told(live):
    display, _ = shown(live)
    display.workers = 2
    display.expect({"read": 3})
    for worker, begins in (("a", True), ("b", True), ("a", False), ("c", True), ("c", False)):
        display.compiling(worker, begins)
    if live:
        assert [t.fields["pace"] for t in display._bars.tasks] == [f"2 workers, {ONCE}"]
        display.compiling("b", False)
        assert [t.fields["pace"] for t in display._bars.tasks] == ["2 workers"]
    else:
        assert display.console.file.getvalue().splitlines() == [
            "compiling        for this machine, once; `fwclass compile` makes all kernels ahead"
        ]
