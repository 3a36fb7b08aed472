"""Strips out of pieces: where they lie, whither they were flown, and when; whatever blocks they were cut into."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from fwclass import pieces
from fwclass.pieces import linked_groups
from fwclass.quality.pieces import NO_TIME, PlacedStrip, lines, pieces_of, strips_of

GAP = 10.0
EAST, NORTH = 500_000.0, 5_400_000.0


def line(
    azimuth: float, start: float, seed: int, width: float = 300.0, length: float = 2400.0
) -> tuple[np.ndarray, ...]:
    """Echoes (x, y, time) of a line at 60 m/s, evenly spread."""
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(-1, 1, (2, 20_000)) * [[width / 2], [length / 2]]
    a = np.radians(azimuth)
    time = start + (v + length / 2) / 60
    x, y = EAST + u * np.cos(a) + v * np.sin(a), NORTH - u * np.sin(a) + v * np.cos(a)
    return np.round(x, 3), np.round(y, 3), time


def strips(
    x: np.ndarray, y: np.ndarray, t: np.ndarray, file: np.ndarray, edge: float, times: bool
) -> list[PlacedStrip]:
    column, row = np.floor(x / edge), np.floor(y / edge)
    places = sorted(set(zip(column.tolist(), row.tolist(), strict=True)))
    blocks = []
    for c, r in places:
        own = (column == c) & (row == r)
        blocks.append(pieces_of(x[own], y[own], t[own], file[own], (c * edge, r * edge), GAP)[0])
    files, spans = (np.concatenate([getattr(b, n) for b in blocks]) for n in ("file", "span"))
    number = lines(files, spans) if times else np.unique(files, return_inverse=True)[1]
    cuts = np.cumsum([len(b.file) for b in blocks])[:-1]
    return strips_of(blocks, [(c * edge, r * edge) for c, r in places], np.split(number, cuts), GAP)


@pytest.mark.parametrize("azimuth", [0.0, 37.0, 90.0, 215.0, 359.0])
def test_a_line_is_told_as_it_was_flown(azimuth: float) -> None:
    x, y, t = line(azimuth, 1_000.0, 0)
    (one,) = strips(x, y, t, np.full(len(x), 7), 256.0, False)
    assert one.timed and one.files == (7,) and one.echoes == 20_000
    assert (one.azimuth - azimuth + 180) % 360 - 180 == pytest.approx(0, abs=0.5)
    assert one.half == pytest.approx((150.0, 1200.0), rel=0.01)
    assert one.centre == pytest.approx((x.mean(), y.mean()), abs=0.1)
    across, along = one.within(x, y)
    assert np.abs(across).max() < 1.05 and np.abs(along).max() < 1.05
    assert np.corrcoef(along, t)[0, 1] > 0.999
    right = np.radians(azimuth + 90)
    assert np.corrcoef(across, x * np.sin(right) + y * np.cos(right))[0, 1] > 0.99


def test_without_times_the_longer_axis_is_the_line() -> None:
    x, y, t = line(120.0, 0.0, 1)
    (one,) = strips(x, y, np.full(len(t), np.nan), np.zeros(len(x), int), 256.0, True)
    assert not one.timed and one.times is None and one.azimuth == pytest.approx(120.0, abs=0.5)


def test_lines_end_where_time_does_whatever_the_files() -> None:
    first, second = line(0.0, 1000.0, 2), line(180.0, 1200.0, 3)
    x, y, t = (np.concatenate(c) for c in zip(first, second, strict=True))
    file = (y > NORTH).astype(int)  # delivered as two tiles
    two = strips(x, y, t, file, 256.0, True)
    assert [s.files for s in two] == [(0, 1), (0, 1)]
    assert [round(s.azimuth) % 360 for s in two] == [0, 180]
    assert [s.times for s in two] == [(1000.0, 1040.0), (1200.0, 1240.0)]


def test_blocks_of_another_size_make_the_same_strips() -> None:
    x, y, t = line(63.0, 1000.0, 4)
    (one,), (other,) = (strips(x, y, t, np.zeros(len(x), int), edge, True) for edge in (128.0, 1024.0))
    assert one.along == pytest.approx(other.along, abs=1e-9) and one.half == pytest.approx(other.half, abs=1e-6)


def test_pieces_do_not_depend_on_the_order_of_echoes() -> None:
    x, y, t = line(10.0, 1000.0, 5)
    t[::3] = np.nan
    t[2::600] = 0.0
    t[1::300] = [1e300, -np.inf, np.inf] * 22 + [1e300]
    file = np.arange(len(x)) % 2
    first, number = pieces_of(x, y, t, file, (EAST, NORTH), GAP)
    order = np.random.default_rng(0).permutation(len(x))
    second, other = pieces_of(x[order], y[order], t[order], file[order], (EAST, NORTH), GAP)
    assert first.sums.tobytes() == second.sums.tobytes() and (number[order] == other).all()
    assert NO_TIME in first.span and first.span[first.span != NO_TIME].min() == 100 and first.sums[:, 0].sum() == len(x)


def test_no_echo_makes_no_piece() -> None:
    nothing = np.empty(0)
    made, number = pieces_of(nothing, nothing, nothing, np.empty(0, np.int64), (0.0, 0.0), GAP)
    assert not len(made.file) and made.sums.shape == (0, 10) and not len(number)
    assert strips_of([made], [(0.0, 0.0)], [number], GAP) == []


def test_strips_hang_together_by_their_pairs() -> None:
    assert linked_groups(5, np.array([0, 3]), np.array([2, 4])).tolist() == [0, 1, 0, 2, 2]
    assert linked_groups(3, np.empty(0, int), np.empty(0, int)).tolist() == [0, 1, 2]


@pytest.mark.parametrize("few", [0, 1000])
@pytest.mark.parametrize("strips", [1, 7, 200])
def test_groups_are_those_of_scipy_by_their_lowest_strip(
    strips: int, few: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pieces, "MOST_BY_HAND", few)
    rng = np.random.default_rng(strips)
    for pairs in (strips // 3, strips // 2, strips, 5 * strips):
        first, second = rng.integers(0, strips, (2, pairs))
        graph = scipy.sparse.coo_matrix((np.ones(pairs), (first, second)), shape=(strips, strips))
        _, wanted = scipy.sparse.csgraph.connected_components(graph, directed=False)
        assert np.array_equal(linked_groups(strips, first, second), wanted)
    chain = rng.permutation(strips)
    assert not linked_groups(strips, chain[:-1], chain[1:]).any()
