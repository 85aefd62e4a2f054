"""Window policies."""

from __future__ import annotations

import numpy as np

from terrafuse.types import TileKey
from terrafuse.window import Tiles3x3, make_window


def test_holds_nine_tiles() -> None:
    window = Tiles3x3(40.0)
    assert window.move(10, 10)
    held = {TileKey(x, y) for x in range(-5, 6) for y in range(-5, 6) if window.holds(TileKey(x, y))}
    assert held == {TileKey(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)}


def test_moves_only_out_of_its_central_half() -> None:
    window = Tiles3x3(40.0)
    window.move(20, 20)
    assert not window.move(49.9, 20)  # 0.75 tiles from the middle
    assert window.move(50.1, 20)
    assert window.holds(TileKey(2, 0))
    assert not window.move(31, 20)


def test_walking_along_a_border_does_not_move_it() -> None:
    window = Tiles3x3(40.0)
    moves = [window.move(40.0 + 0.5 * np.sin(k), 20 + k * 0.001) for k in range(1000)]
    assert sum(moves) == 1


def test_all_keeps_all() -> None:
    window = make_window("all", 40.0)
    assert not window.move(1e6, 0)
    assert window.holds(TileKey(0, 0))
