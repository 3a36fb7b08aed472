"""When a run is due: with clocks that are set, sleep and change to summer time."""

from __future__ import annotations

from datetime import datetime
from zoneinfo import ZoneInfo

import pytest

from fwclass.operate.schedule.ticks import Cron, Interval, Now, now, tick_after

BERLIN = ZoneInfo("Europe/Berlin")
HOUR, DAY = 3600.0, 86400.0


def at(text: str, fold: int = 0) -> float:
    """Seconds since the epoch of a time in Berlin."""
    return datetime.fromisoformat(text).replace(tzinfo=BERLIN, fold=fold).timestamp()


def nightly(since: str) -> Cron:
    return Cron("0 3 * * *", BERLIN, DAY, at(since))


def walk(ticks, moments):
    """The moments at which a run is due, each taken at once."""
    ran = []
    for moment in moments:
        ticks = ticks.follow_clock(moment)
        if ticks.wait(moment) <= 0:
            ran.append(moment)
            ticks = ticks.after_run(moment)
    return ran, ticks


def test_an_interval_begins_at_once_and_keeps_its_grid():
    ran, _ = walk(Interval(10.0, 100.0), [Now(0.0, 100.0 + k) for k in range(35)])
    assert [m.steady for m in ran] == [100.0, 110.0, 120.0, 130.0]


@pytest.mark.parametrize("late", [10.0, 25.0, 1e6])
def test_missed_ticks_of_an_interval_are_one_run(late):
    ticks = Interval(10.0, 100.0).after_run(Now(0.0, 100.0))
    ran, ticks = walk(ticks, [Now(0.0, 100.0 + late + k / 10) for k in range(40)])
    assert len(ran) == 1 and 0.0 < ticks.wait(ran[0]) <= 10.0
    assert (ticks.due - 100.0) % 10.0 == pytest.approx(0.0, abs=1e-6)


def test_an_interval_does_not_see_the_wall_clock():
    steady = [Now(wall, 100.0 + k) for k, wall in enumerate([0.0, 1e9, -1e9, 5.0, 7e12])]
    ran, _ = walk(Interval(2.0, 100.0), steady)
    assert [m.steady for m in ran] == [100.0, 102.0, 104.0]


def test_cron_waits_for_its_first_tick_and_runs_once_a_night():
    start = at("2026-01-10T12:00")
    ran, _ = walk(nightly("2026-01-10T12:00"), [Now(start + 300 * k, 300.0 * k) for k in range(3 * 288)])
    assert [m.wall for m in ran] == [at(f"2026-01-{d}T03:00") for d in (11, 12, 13)]


@pytest.mark.faults
def test_a_clock_set_forwards_runs_once():
    ticks = nightly("2026-01-10T02:00")
    ran, ticks = walk(ticks, [Now(at("2026-01-10T02:30"), 0.0), Now(at("2026-01-20T10:00"), 5.0)])
    assert len(ran) == 1
    assert ticks.next == at("2026-01-21T03:00")


@pytest.mark.faults
def test_a_clock_set_back_repeats_no_tick():
    ticks = nightly("2026-01-10T02:00")
    ran, ticks = walk(ticks, [Now(at("2026-01-10T03:00") + 0.2, 0.0)])
    back = [Now(at("2026-01-10T02:50") + 60 * k, 10.0 + 60 * k) for k in range(60)]
    again, ticks = walk(ticks, back)
    assert len(ran) == 1 and not again
    assert ticks.next == at("2026-01-11T03:00")


def test_a_tick_that_had_no_run_comes_after_the_clock_was_set_back():
    """Started with a clock that was ahead: the tick of the true night is not lost."""
    moments = [Now(at("2026-01-10T10:00"), 0.0), *(Now(at("2026-01-10T02:00") + 300 * k, 300.0 * k) for k in range(24))]
    ran, _ = walk(nightly("2026-01-10T10:00"), moments)
    assert [m.wall for m in ran] == [at("2026-01-10T03:00")]


def test_a_clock_that_was_far_ahead_does_not_stop_the_schedule():
    ticks = nightly("2026-01-10T02:00")
    _, ticks = walk(ticks, [Now(at("2099-01-10T04:00"), 1.0)])
    right = [Now(at("2026-01-10T12:00") + 600 * k, 600.0 * k) for k in range(2 * 144)]
    ran, _ = walk(ticks, right)
    assert [m.wall for m in ran] == [at("2026-01-11T03:00"), at("2026-01-12T03:00")]


def test_ticks_missed_while_no_schedule_was_there_are_one_run():
    ticks = Cron("0 3 * * *", BERLIN, DAY, since=at("2026-01-14T09:00"), last=at("2026-01-10T03:00"))
    ran, ticks = walk(ticks, [Now(at("2026-01-14T09:00") + k, float(k)) for k in range(100)])
    assert len(ran) == 1 and ticks.next == at("2026-01-15T03:00")


def after(rule: str, moment: float, count: int) -> list[float]:
    found = []
    for _ in range(count):
        moment = tick_after(rule, BERLIN, moment)
        found.append(moment)
    return found


def test_summer_time_begins():
    """2026-03-29: 02:00 is 03:00."""
    start = at("2026-03-28T12:00")
    assert after("30 2 * * *", start, 2) == [at("2026-03-29T03:00"), at("2026-03-30T02:30")]
    assert after("30 * * * *", at("2026-03-29T01:00"), 2) == [at("2026-03-29T01:30"), at("2026-03-29T03:30")]
    assert at("2026-03-29T03:30") - at("2026-03-29T01:30") == HOUR


def test_summer_time_ends():
    """2026-10-25: 02:00 to 03:00 comes twice."""
    start = at("2026-10-24T12:00")
    assert after("30 2 * * *", start, 2) == [at("2026-10-25T02:30"), at("2026-10-26T02:30")]
    hourly = after("30 * * * *", at("2026-10-25T01:00"), 4)
    assert hourly == [at("2026-10-25T01:30"), at("2026-10-25T02:30"), at("2026-10-25T02:30", 1), at("2026-10-25T03:30")]
    assert tick_after("15 2 * * *", BERLIN, at("2026-10-25T02:10", 1)) == at("2026-10-26T02:15")


@pytest.mark.parametrize("day", ["2026-03-29", "2026-10-25", "2026-06-01"])
@pytest.mark.parametrize("rule", ["0 3 * * *", "30 2 * * *", "*/20 * * * *", "15 1-4 * * *", "0 */2 * * *"])
def test_ticks_only_go_forward_and_any_start_between_two_finds_the_second(day, rule):
    ticks = after(rule, at(f"{day}T00:00"), 12)
    assert ticks == sorted(set(ticks))
    for before, then in zip(ticks, ticks[1:], strict=False):
        for share in (0.0, 0.25, 0.5, 0.99):
            assert tick_after(rule, BERLIN, before + share * (then - before)) == then


def test_both_clocks_are_read():
    first, second = now(), now()
    assert second.steady >= first.steady and first.wall > 1.7e9
