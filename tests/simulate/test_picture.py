"""Pictures of worlds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from terrafuse.errors import InputError
from terrafuse.simulate.picture import MOVING, world_colours, write_world_picture
from terrafuse.simulate.worlds import parking, soccer_field


def test_a_picture_is_the_world_north_up(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    world = parking(0)
    write_world_picture(world, tmp_path / "parking.png", 0.5, time_s=30.0)
    with image.open(tmp_path / "parking.png") as picture:
        pixels = np.asarray(picture)
    assert pixels.shape == (120, 160, 3)
    expected = world_colours(world, 0.5, world.bodies(30.0))[::-1]
    np.testing.assert_allclose(pixels / 255, np.clip(expected, 0, 1), atol=0.5 / 255 + 1e-9)
    moving = (expected == MOVING).all(axis=2).sum()
    assert 0 < moving < 500
    assert not (world_colours(world, 0.5) == MOVING).all(axis=2).any()


def test_a_picture_of_too_many_pixels_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("PIL.Image")
    with pytest.raises(InputError, match="give more metres a pixel"):
        write_world_picture(soccer_field(), tmp_path / "field.png", 1e-4)
