"""The film: frames of the map as it grows, bounded in number, from an image that is the replica's in every cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse import views
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.models.layers import layers_of
from terrafuse.replica import Replica
from terrafuse.simulate.mission import film as film_module
from terrafuse.simulate.mission import reel
from terrafuse.simulate.mission.engine import Mission
from terrafuse.simulate.mission.film import Film
from terrafuse.simulate.mission.growing import GrowingMap
from terrafuse.types import Bounds, Pose, Scan
from tests.simulate.missions import small

Image = pytest.importorskip("PIL.Image")
pytest.importorskip("matplotlib")
pytest.importorskip("embreex")

LATTICE = Lattice(0.5, 4.0)
BOUNDS = Bounds(-6.0, -6.0, 7.0, 5.0)


def scan(seed: int) -> Scan:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-7, 7, (40, 3)) * (1, 1, 0.1)
    return Scan(seed, points, Pose.identity())


@given(
    st.lists(st.tuples(st.sampled_from(["prior", "r1", "r2"]), st.integers(0, 50)), max_size=6),
    st.sampled_from([50, 13, 9]),
)
def test_the_growing_map_is_the_replicas(looks: list[tuple[str, int]], most_pixels: int) -> None:
    replica = Replica(LATTICE, make_model("elevation"))
    mappers = {name: Mapper(name, LATTICE) for name in ("prior", "r1", "r2")}
    layer = layers_of(replica.model)["height"]
    growing = GrowingMap(replica, layer, BOUNDS, most_pixels)
    for name, seed in looks:
        since = mappers[name].revision
        mappers[name].integrate(scan(seed))
        replica.apply(mappers[name].delta(since))
        growing.update()
    factor = round(growing.pixel_m / 0.5)
    window = tuple(factor * edge for edge in growing.window)
    expected = views.reduced(replica, layer, window, factor)  # type: ignore[arg-type]
    np.testing.assert_allclose(growing.values, expected, rtol=1e-12)
    seen = views.reduced(Replica(store=replica.store, without=["prior"]), layer, window, factor)  # type: ignore[arg-type]
    np.testing.assert_array_equal(growing.seen, np.isfinite(seen))


def test_pixels_are_blocks_that_divide_a_tile() -> None:
    """13 m are 26 cells of 0.5 m; 9 pixels need blocks of 4, the least divisor of a tile's 8 cells from 26/9 on."""
    replica = Replica(LATTICE, make_model("elevation"))
    assert GrowingMap(replica, layers_of(replica.model)["height"], BOUNDS, 9).pixel_m == 2.0


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Film, Path]:
    folder = tmp_path_factory.mktemp("film")
    mission = Mission(small(), folder=folder)
    film = Film(mission)
    mission.run([film])
    film.end(mission)
    film.write(folder / "film.gif")
    return film, folder / "film.gif"


def test_frames_come_each_frame_s_and_at_the_end(filmed: tuple[Film, Path]) -> None:
    """6 s, a frame a second: after the tick to 0.1 s, at 1, 2, … 6."""
    film, path = filmed
    assert [frame.time_s for frame in film._frames] == pytest.approx([0.1, 1, 2, 3, 4, 5, 6])
    with Image.open(path) as picture:
        assert picture.n_frames == 7
        assert picture.size[0] <= 700
        assert picture.info["loop"] == 0


def test_the_film_shows_the_map_growing(filmed: tuple[Film, Path]) -> None:
    with Image.open(filmed[1]) as picture:
        frames = []
        for k in (0, picture.n_frames - 1):
            picture.seek(k)
            frames.append(np.asarray(picture.convert("RGB")))
    assert (frames[0] != frames[1]).any(axis=2).mean() > 0.01
    shares = [frame.share for frame in filmed[0]._frames]
    assert shares == sorted(shares)
    assert shares[-1] > 0


def test_long_films_are_thinned_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """At most 4 frames of 20 ticks, a tick a frame: still spread over the whole time, and the last one is the end."""
    monkeypatch.setattr(film_module, "MOST_FRAMES", 4)
    mission = Mission(small(), folder=tmp_path)
    film = Film(mission)
    film._every_s = 0.1
    for tick in range(1, 21):
        mission.now_s = tick * 0.1
        film(mission)
    film.end(mission)
    times = [frame.time_s for frame in film._frames]
    assert len(times) <= 5
    assert times[0] == pytest.approx(0.1)
    assert times[-1] == pytest.approx(2.0)
    assert max(np.diff(times)) <= 0.8 + 1e-9


@pytest.mark.parametrize(("cells", "pixels"), [(200, 600), (36, 612), (400, 640), (300, 600), (641, 640), (3000, 640)])
def test_films_are_about_as_large_whatever_the_world(cells: int, pixels: int) -> None:
    """3 · 200 = 600 and 17 · 36 = 612 pixels; 400 cells would be 400 pixels, too few, so they are stretched to 640."""
    assert round(cells * reel.scale_of((cells, cells // 2))) == pixels
