"""The grey frame: rounded outward, bounded, the same tomorrow; and the paper's field, which fits one."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import CodecError, InputError
from terrafuse.exchange.grey_frame import (
    MAX_FRAME,
    Frame,
    assemble,
    cells_of,
    decode_frame,
    encode_frame,
    frames_of,
)
from terrafuse.kernels.grey import CELL, FULL
from terrafuse.models import fold, make_model
from terrafuse.replica import Replica
from terrafuse.testing.deltas import deltas_of
from terrafuse.types import Array, TileKey
from tests.exchange.make_golden_grey import golden_frame, parts
from tests.models.soccer import LATTICE, TEAM, field, team_scans

GOLDEN = bytes.fromhex(
    # version
    "01"
    # sequence
    "07"
    # width, height
    "0302"
    # i0
    "feffffff"
    # j0
    "05000000"
    # a and b of each cell
    "00ff003d7fff00ff748bffff"
)
"""Made by tests/exchange/make_golden_grey.py. Bytes that were once written must be read for ever."""


def random_cells(seed: int, height: int, width: int) -> Array:
    """Any intervals, with stamps and revisions."""
    rng = np.random.default_rng(seed)
    a, b = np.sort(rng.integers(0, FULL + 1, (2, height, width)), axis=0)
    cells = np.zeros((height, width), CELL)
    cells["a"], cells["c"], cells["revision"], cells["stamp"] = a, FULL - b, 1, 5
    return cells


def assert_equal(one: Frame, other: Frame) -> None:
    assert (one.sequence, one.i0, one.j0) == (other.sequence, other.i0, other.j0)
    np.testing.assert_array_equal(one.a, other.a)
    np.testing.assert_array_equal(one.b, other.b)


def test_golden_bytes() -> None:
    assert encode_frame(golden_frame()) == GOLDEN
    assert b"".join(part for _, part in parts(GOLDEN)) == GOLDEN
    frame = decode_frame(GOLDEN)
    assert_equal(frame, golden_frame())
    assert (frame.sequence, frame.i0, frame.j0) == (7, -2, 5)
    # 32767/65535 = 127.5/255, rounded down; b = 1 - 50000/65535 = 60.4/255, rounded up
    # a = 30000/65535 = 116.7/255; b = 1 - 30001/65535 = 138.3/255
    assert frame.a.tolist() == [[0, 0, 127], [0, 116, 255]]
    assert frame.b.tolist() == [[255, 61, 255], [255, 139, 255]]


@given(seed=st.integers(0, 2**32), height=st.integers(1, 34), width=st.integers(1, 33))
@settings(max_examples=50)
def test_the_true_interval_is_always_inside(seed: int, height: int, width: int) -> None:
    """And no wider than need be: less than 1/255 is lost at either end."""
    cells = random_cells(seed, height, width)
    (frame,) = frames_of(cells, 3, -4, 9)
    a, b = (getattr(decode_frame(encode_frame(frame)), side).astype(int) * FULL for side in ("a", "b"))
    true_a, true_b = cells["a"].astype(int) * 255, (FULL - cells["c"].astype(int)) * 255
    assert ((a <= true_a) & (true_b <= b)).all()
    assert ((true_a - a < FULL) & (b - true_b < FULL)).all()


@given(
    height=st.integers(1, 90),
    width=st.integers(1, 600),
    i0=st.integers(-(2**31), 2**31 - 1000),
    j0=st.integers(-(2**31), 2**31 - 1000),
    data=st.data(),
)
@settings(max_examples=40)
def test_a_map_travels_in_frames_in_any_order(height: int, width: int, i0: int, j0: int, data: st.DataObject) -> None:
    cells = random_cells(height * width, height, width)
    messages = [encode_frame(frame) for frame in frames_of(cells, i0, j0, 300 % 256)]
    assert max(map(len, messages)) <= MAX_FRAME
    order = data.draw(st.permutations(messages)) + data.draw(st.lists(st.sampled_from(messages), max_size=3))
    found_i0, found_j0, found = assemble(map(decode_frame, order), stamp_ns=8, revision=2)
    assert (found_i0, found_j0, found.shape) == (i0, j0, cells.shape)
    np.testing.assert_array_equal(found["a"], cells["a"] // 257 * 257)
    np.testing.assert_array_equal(found["c"], cells["c"] // 257 * 257)
    informed = (found["a"] > 0) | (found["c"] > 0)
    np.testing.assert_array_equal(found["revision"], np.where(informed, 2, 0))
    np.testing.assert_array_equal(found["stamp"], np.where(informed, 8, 0))


def test_a_large_map_is_cut_into_few_frames() -> None:
    frames = frames_of(np.zeros((400, 400), CELL), 0, 0, 1)
    assert len(frames) <= 1.05 * 400 * 400 / 1150


def test_frames_that_are_missing_leave_their_cells_unknown() -> None:
    frames = frames_of(random_cells(1, 100, 24), 0, 0, 1)
    assert len(frames) == 3
    _, _, found = assemble([frames[2], frames[0]], 1, 1)
    high = frames[0].a.shape[0]
    assert not found[high : 2 * high].view(np.uint8).any()
    assert found[:high].view(np.uint8).any()


# --- bytes that lie --------------------------------------------------------------------------------------------------


def frame_bytes(version=1, sequence=0, width=2, height=1, i0=0, j0=0, cells=bytes([0, 255, 0, 255])) -> bytes:
    return struct.pack("<BBBBii", version, sequence, width, height, i0, j0) + cells


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (b"", "0 bytes are no grey frame"),
        (frame_bytes(cells=b""), "12 bytes are no grey frame"),
        (frame_bytes(cells=bytes(2301)), "2313 bytes are no grey frame"),
        (frame_bytes(version=2), "version 2; this terrafuse reads version 1"),
        (frame_bytes(width=3), "3×1 cells with 4 bytes"),
        (frame_bytes(width=255, height=255), "255×255 cells with 4 bytes"),
        (frame_bytes(width=0), "0×1 cells with 4 bytes"),
        (frame_bytes(cells=bytes(5)), "2×1 cells with 5 bytes"),
        (frame_bytes(cells=bytes([0, 255, 9, 8])), "end before they begin"),
        (frame_bytes(i0=2**31 - 3), "over the edge"),
    ],
)
def test_lies_are_rejected(message: bytes, reason: str) -> None:
    decode_frame(frame_bytes())
    with pytest.raises(CodecError, match=reason):
        decode_frame(message)


@given(st.binary(max_size=80) | st.binary(max_size=60).map(lambda noise: GOLDEN[:4] + noise))
@settings(max_examples=400)
def test_noise_is_rejected_or_is_a_frame(noise: bytes) -> None:
    """What is read is what would be written: no byte is ignored."""
    try:
        frame = decode_frame(noise)
    except CodecError:
        return
    assert encode_frame(frame) == noise


@given(st.integers(0, len(GOLDEN) - 1))
def test_a_cut_frame_is_rejected(length: int) -> None:
    with pytest.raises(CodecError):
        decode_frame(GOLDEN[:length])


def test_frames_that_do_not_belong_together_are_rejected() -> None:
    one, two = (decode_frame(frame_bytes(sequence=k, i0=2 * k)) for k in (0, 1))
    with pytest.raises(CodecError, match=r"of 2 maps \(\[0, 1\]\)"):
        assemble([one, two], 1, 1)
    with pytest.raises(CodecError, match="of 0 maps"):
        assemble([], 1, 1)
    with pytest.raises(CodecError, match="overlaps"):
        assemble([one, decode_frame(frame_bytes(i0=1))], 1, 1)
    with pytest.raises(CodecError, match="spread over"):
        assemble([one, decode_frame(frame_bytes(i0=2**30, j0=2**30))], 1, 1)


def test_what_does_not_fit_is_refused() -> None:
    cells = np.zeros((35, 33), np.uint8)
    with pytest.raises(InputError, match="33×35 cells do not fit"):
        encode_frame(Frame(0, 0, 0, cells, cells))
    with pytest.raises(InputError, match="too far from the origin"):
        encode_frame(Frame(0, 2**31, 0, cells[:1], cells[:1]))
    assert frames_of(np.zeros((0, 5), CELL), 0, 0, 0) == []


# --- the paper's field -----------------------------------------------------------------------------------------------


def test_three_robots_on_the_papers_field() -> None:
    """24×36 cells are 1728 + 12 bytes; the map of frames is the map of deltas, rounded to 1/255.

    Rounding keeps order, and fusing only compares and chooses. Only evidence of less than 1/255 can't be seen in
    a frame and so can't contradict anything there.
    """
    model = make_model("grey")
    direct, by_frame, robots = Replica(LATTICE, model), [], []
    for name in TEAM:
        alone = Replica(LATTICE, model)
        for delta in deltas_of(name, team_scans(name), LATTICE, model):
            direct.apply(delta)
            alone.apply(delta)
        robots.append(field(alone.cells(TileKey(0, 0))))
        (frame,) = frames_of(robots[-1], 0, 0, 1)
        message = encode_frame(frame)
        assert len(message) == 1728 + 12
        by_frame.append(cells_of(decode_frame(message), stamp_ns=1, revision=1))
    fused = fold(model, [cells.reshape(-1) for cells in by_frame], LATTICE).reshape(36, 24)
    expected = field(direct.cells(TileKey(0, 0)))
    faint = np.any([np.maximum(c["a"], c["c"]) - 1 < 256 for c in robots] & model.known(np.stack(robots)), axis=0)
    assert faint.mean() < 0.15
    for side in ("a", "c"):
        np.testing.assert_array_equal(fused[side][~faint], expected[side][~faint] // 257 * 257)
    assert ((expected["a"] > 0) & ~faint).sum() > 50
    assert ((expected["c"] > 0) & ~faint).sum() > 200
