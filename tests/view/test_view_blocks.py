"""Blocks: every echo once, where it is, whatever the tiles; and even levels."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from fwclass.view.blocks import BYTES, DRAWN, HEAD, STEP, ByteScale, block, column_block, nothing
from fwclass.view.cache import Cache
from fwclass.view.pyramid import Pyramid, levels_of, order_blocks, sorted_rows

SIZE = 50.0
TILES = np.array([[10, 20], [11, 20], [10, 21], [12, 22]])


def cloud(n: int, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    tile = TILES[rng.integers(0, len(TILES), n)]
    z = rng.uniform(100, 140, n)
    return {
        "x": (tile[:, 0] + rng.random(n)) * SIZE,
        "y": (tile[:, 1] + rng.random(n)) * SIZE,
        "z": z,
        "classification": rng.integers(0, 256, n).astype(np.uint8),
        "confidence": np.where(rng.random(n) < 0.1, np.nan, rng.random(n)).astype(np.float32),
        "height_above_ground": np.where(rng.random(n) < 0.1, np.nan, rng.uniform(-150, 700, n)).astype(np.float32),
        "intensity": rng.integers(0, 65536, n).astype(np.uint16),
        "rank": rng.integers(0, 2**64, n, np.uint64),
    }


def decoded(data: bytes) -> dict[str, np.ndarray]:
    """A block as the page reads it, written anew from the format's words."""
    size, *node, count = struct.unpack_from("<5I", data)
    low, step, rise = np.array(struct.unpack_from("<3d", data, 24)), *struct.unpack_from("<2d", data, 48)
    assert len(data) == HEAD.size + size
    p = np.frombuffer(zlib.decompress(data[HEAD.size :]), np.uint8).reshape(BYTES, count).astype(np.int64)
    d = [p[2 * k] | p[2 * k + 1] << 8 for k in range(4)]
    x, y, z, h = (np.cumsum((v >> 1) ^ -(v & 1)) for v in d)
    place = low + np.c_[((x & 65535) + 0.5) * step, ((y & 65535) + 0.5) * step, (z & 65535) * rise]
    height = (h + np.trunc((z & 65535) * rise / 0.01).astype(np.int64)) & 65535
    fields = {"height": height, "intensity": p[8] | p[9] << 8, "class": p[10], "sure": p[11]}
    return {"node": np.array(node), "place": place, "step": step, "rise": rise, **fields}


@pytest.mark.parametrize("echoes", [1, 7, 5000])
@pytest.mark.parametrize("size", [200, 100_000])
@pytest.mark.parametrize("together", [0, 300, 10_000])
def test_every_echo_is_in_one_block_where_it_lies(echoes: int, size: int, together: int) -> None:
    c = cloud(echoes)
    pyramid = Pyramid.over(TILES, echoes, SIZE, size, together)
    level = levels_of(pyramid, c["rank"])
    order, nodes = order_blocks(pyramid, level, c["x"], c["y"])
    assert sorted(order) == list(range(echoes))
    assert {n[0] for n in nodes} <= {k for k in pyramid.levels() if k <= pyramid.coarse or k >= pyramid.own}
    assert (level <= pyramid.coarse).sum() <= 2 * together + 200
    origin = (*pyramid.corner, 90.0)
    for node, (first, last) in nodes.items():
        rows = order[first:last]
        got = decoded(block(pyramid, node, {n: c[n] for n in DRAWN}, rows, origin))
        assert tuple(got["node"]) == node and pyramid.has(node)
        want = np.c_[c["x"], c["y"], c["z"]][rows] - origin
        assert np.abs(got["place"] - want)[:, :2].max() <= got["step"] / 2 + 1e-9
        assert np.abs(got["place"] - want)[:, 2].max() <= got["rise"] / 2 + 1e-9
        assert got["step"] >= STEP
        assert (got["class"] == c["classification"][rows]).all() and (got["intensity"] == c["intensity"][rows]).all()
        sure, height = c["confidence"][rows], c["height_above_ground"][rows]
        assert ((got["sure"] == 255) == np.isnan(sure)).all() and ((got["height"] == 0) == np.isnan(height)).all()
        known = np.isfinite(height)
        told = (got["height"][known] - 1) * 0.01 - 100
        assert np.abs(told - np.clip(height[known], -100, 555.34)).max(initial=0) <= 0.0051
        if node[0] >= pyramid.own:
            tile = pyramid.tile_of(node)
            assert (np.floor(c["x"][rows] / SIZE) == tile[0]).all() and (np.floor(c["y"][rows] / SIZE) == tile[1]).all()


def test_levels_double_and_are_even() -> None:
    c = cloud(200_000)
    pyramid = Pyramid.over(TILES, 200_000, SIZE, 5000, 200_000)
    level = levels_of(pyramid, c["rank"])
    west = c["x"] < 11 * SIZE
    for k in pyramid.levels():
        share = pyramid.share(k)
        for part in (west, ~west):
            n = part.sum()
            assert abs((level[part] == k).sum() - share * n) < 5 * np.sqrt(share * n) + 1
    assert abs(sum(pyramid.share(k) for k in pyramid.levels()) - 1) < 1e-12


def test_levels_follow_the_hash_alone() -> None:
    """Whatever is shown up to a level are the echoes with the lowest hashes."""
    c = cloud(50_000)
    level = levels_of(Pyramid.over(TILES, 50_000, SIZE, 2000, 50_000), c["rank"])
    assert (np.diff(level[np.argsort(c["rank"])]) >= 0).all()


@pytest.mark.parametrize("bits", [0, 1, 11, 12, 23, 40, 64])
@pytest.mark.parametrize("shift", [0, 5, 58])
def test_rows_are_sorted_as_numpy_sorts_them(bits: int, shift: int) -> None:
    """With many that are equal, none or all; those stay as they were."""
    rng = np.random.default_rng(bits)
    for n in (0, 1, 2, 3000):
        key = rng.integers(0, 1 << bits, n, np.uint64) if bits < 64 else rng.integers(0, 2**64 - 1, n, np.uint64)
        key = (key << np.uint64(shift)) | np.uint64(1)
        order = rng.permutation(n)
        assert np.array_equal(sorted_rows(key, order), order[np.argsort(key[order], kind="stable")])


def test_nothing_has_no_blocks() -> None:
    none = np.empty(0)
    order, nodes = order_blocks(Pyramid.over(TILES, 1, SIZE, 10, 10), none.astype(np.int8), none, none)
    assert not len(order) and nodes == {}


def test_columns_keep_what_has_no_value() -> None:
    values = np.array([np.nan, 0.0, 5.0, 10.0, -3.0, 99.0, np.inf])
    assert ByteScale(0.0, 10.0).bytes_of(values).tolist() == [255, 0, 127, 254, 0, 254, 255]
    assert ByteScale(0.0, 0.0).bytes_of(np.full(3, np.nan)).tolist() == [255, 255, 255]
    assert len(column_block((0, 0, 0), np.zeros(9, np.uint8))) > HEAD.size
    assert decoded(nothing((3, 1, 1)))["place"].shape == (0, 3)


def test_the_cache_forgets_what_was_not_used() -> None:
    cache, made = Cache(10), []
    for key in "abca":
        cache.get(key, lambda key=key: made.append(key) or b"12345")
    assert made == list("abca") and cache.held <= 10
    with pytest.raises(ZeroDivisionError):
        cache.get("d", lambda: 1 / 0)
    assert cache.get("d", lambda: b"1") == b"1"
