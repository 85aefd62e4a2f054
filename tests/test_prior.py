"""What is known beforehand, as one more contribution."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from terrafuse.errors import InputError
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.prior import CONFIDENCE, open_prior
from terrafuse.replica import Replica
from terrafuse.types import Array, Bounds
from tests.program import terrafuse

LATTICE = Lattice(1.0, 10.0)
TERRAIN = make_model("terrain")


def square(west: float, south: float, side: float, **properties: Any) -> dict[str, Any]:
    ring = [[west, south], [west + side, south], [west + side, south + side], [west, south + side], [west, south]]
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }


def geojson(path: Path, *features: dict[str, Any], **members: Any) -> Path:
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features, **members}))
    return path


def dem(path: Path, values: Array, west: float, north: float, crs: str | None = None, **bands: Array) -> Path:
    """A raster of 2 m pixels; `values` are heights, NaN where unknown."""
    arrays = {"height": values, **bands}
    with rasterio.open(
        path, "w", driver="GTiff", height=values.shape[0], width=values.shape[1], count=len(arrays),
        dtype="float64", transform=from_origin(west, north, 2.0, 2.0), crs=crs, nodata=np.nan,
    ) as out:  # fmt: skip
        for number, (name, array) in enumerate(arrays.items(), 1):
            out.write(array, number)
            out.set_band_description(number, name)
    return path


def layers_of(*files: str | Path, names: tuple[str, ...], lattice: Lattice = LATTICE) -> dict[str, Array]:
    """The layers over (0, 0) to (10, 10) of a map that only the prior is in, [j, i] from the south."""
    replica = Replica(lattice, TERRAIN)
    for delta in open_prior([str(file) for file in files]).deltas(lattice, TERRAIN):
        replica.apply(delta)
    assert replica.robots == ["prior"]
    return {name: replica.layer(name, Bounds(0, 0, 10, 10)).values[::-1] for name in names}


def test_houses_of_a_known_height(tmp_path: Path) -> None:
    """Cells whose centres lie within [2, 5) get the height; the others stay unknown."""
    file = geojson(tmp_path / "houses.geojson", square(2.0, 3.0, 3.0, height_m=10, confidence=0.25))
    layers = layers_of(file, names=("height", "confidence"))
    expected = np.full((10, 10), np.nan)
    expected[3:6, 2:5] = 10.0
    np.testing.assert_array_equal(layers["height"], expected)
    np.testing.assert_allclose(layers["confidence"][3:6, 2:5], 0.25 * 255)


def test_a_height_without_a_confidence_is_hardly_believed(tmp_path: Path) -> None:
    file = geojson(tmp_path / "houses.geojson", square(0.0, 0.0, 10.0, height_m=10))
    np.testing.assert_allclose(layers_of(file, names=("confidence",))["confidence"], CONFIDENCE * 255)
    surer = layers_of(f"{file}?confidence=0.5", names=("confidence",))
    np.testing.assert_allclose(surer["confidence"], 0.5 * 255)


def test_the_last_that_says_something_counts_each_property_by_itself(tmp_path: Path) -> None:
    base = geojson(tmp_path / "all.geojson", square(0, 0, 10, height_m=1, communications=1))
    more = geojson(tmp_path / "more.json", square(0, 0, 4, height_m=7), square(2, 2, 4, gps_quality=0))
    layers = layers_of(base, more, names=("height", "gps_quality", "communications"))
    assert (layers["height"][1, 1], layers["height"][5, 5]) == (7.0, 1.0)
    assert np.isnan(layers["gps_quality"][1, 1])
    assert layers["gps_quality"][3, 3] == 0.0
    assert (layers["communications"] == 1.0).all()


def test_static_layers_without_heights(tmp_path: Path) -> None:
    file = geojson(tmp_path / "links.geojson", square(0, 0, 5, communications=0))
    layers = layers_of(file, names=("height", "communications"))
    assert layers["communications"][2, 2] == 0.0
    assert np.isnan(layers["height"]).all()


def test_a_dem_north_up(tmp_path: Path) -> None:
    """2 m pixels, the first row in the north: pixel (0, 0) covers x 0…2, y 8…10."""
    values = np.arange(25.0).reshape(5, 5)
    values[4, 4] = np.nan
    quality = np.full((5, 5), 2.0)
    file = dem(tmp_path / "dem.tif", values, 0.0, 10.0, gps_quality=quality)
    layers = layers_of(file, names=("height", "gps_quality", "confidence"))
    np.testing.assert_array_equal(layers["height"], np.kron(values[::-1], np.ones((2, 2))))
    assert (layers["gps_quality"] == 2.0).all()
    assert layers["confidence"][9, 0] == pytest.approx(CONFIDENCE * 255)


def test_a_dem_that_reaches_over_many_tiles(tmp_path: Path) -> None:
    values = np.random.default_rng(0).normal(size=(15, 20))
    file = dem(tmp_path / "dem.tif", values, -20.0, 14.0)
    replica = Replica(LATTICE, TERRAIN)
    for delta in open_prior([str(file)]).deltas(LATTICE, TERRAIN):
        replica.apply(delta)
    whole = replica.layer("height")
    np.testing.assert_array_equal(whole.values, np.kron(values, np.ones((2, 2))))
    assert (float(whole.x[0]), float(whole.y[0])) == (-19.5, 13.5)


def test_polygons_in_longitude_and_latitude(tmp_path: Path) -> None:
    import pyproj

    lattice = Lattice(1.0, 10.0, "EPSG:32632")
    to_degrees = pyproj.Transformer.from_crs(32632, 4326, always_xy=True).transform
    west, south = 500_000.0, 4_000_000.0
    feature = square(0, 0, 1, height_m=5)
    ring = [to_degrees(west + x, south + y) for x, y in ((0, 0), (6, 0), (6, 4), (0, 4), (0, 0))]
    feature["geometry"]["coordinates"] = [ring]
    file = geojson(tmp_path / "a.geojson", feature)
    replica = Replica(lattice, TERRAIN)
    for delta in open_prior([f"{file}?crs=EPSG:4326"]).deltas(lattice, TERRAIN):
        replica.apply(delta)
    height = replica.layer("height")
    assert height.shape == (4, 6)
    assert (float(height.x[0]), float(height.y[-1])) == (west + 0.5, south + 0.5)


def test_deltas_are_the_same_every_time(tmp_path: Path) -> None:
    file = geojson(tmp_path / "a.geojson", square(0, 0, 25, height_m=5))
    one, two = ([d.identity for d in open_prior([str(file)]).deltas(LATTICE, TERRAIN)] for _ in range(2))
    assert one == two


RING = [[0, 0], [1, 0], [1, 1], [0, 0]]
BAD = {
    "no such file": ("missing.geojson", None, "no such file"),
    "unknown ending": ("a.shp", "x", "neither a raster nor GeoJSON"),
    "no JSON": ("a.geojson", "{", "can't be read as GeoJSON"),
    "no collection": ("a.geojson", "[]", "FeatureCollection"),
    "no features": ("a.geojson", json.dumps({"features": []}), "holds no feature"),
    "a point": (
        "a.geojson",
        json.dumps({"features": [{"geometry": {"type": "Point", "coordinates": [0, 0]}, "properties": {}}]}),
        "feature 1: a Point",
    ),
    "no property": (
        "a.geojson",
        json.dumps({"features": [{"geometry": {"type": "Polygon", "coordinates": [RING]}, "properties": {"a": 1}}]}),
        "says nothing; give height_m",
    ),
    "height as text": (
        "a.geojson",
        json.dumps({"features": [{"geometry": {"type": "Polygon", "coordinates": [RING]},
                                  "properties": {"height_m": "10 m"}}]}),
        "height_m is '10 m'",
    ),
    "ring too short": (
        "a.geojson",
        json.dumps({"features": [{"geometry": {"type": "Polygon", "coordinates": [RING[:2]]},
                                  "properties": {"height_m": 1}}]}),
        "at least 4 finite points",
    ),
    "no raster": ("a.tif", "x", "can't be read as a raster"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_named_with_a_remedy(case: str, tmp_path: Path) -> None:
    name, content, message = BAD[case]
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        open_prior([str(tmp_path / name)])
    assert name in str(caught.value)


ODD = {
    "properties in a list": ({**square(0, 0, 1), "properties": [1]}, {}, "properties by name"),
    "a number of 400 digits": (square(0, 0, 1, height_m=10**400), {}, "height_m is 1000"),
    "a CRS of text": (square(0, 0, 1, height_m=1), {"crs": {"properties": "x"}}, "names no CRS"),
}


@pytest.mark.parametrize("case", ODD)
def test_odd_features_are_refused(case: str, tmp_path: Path) -> None:
    feature, members, message = ODD[case]
    with pytest.raises(InputError, match=message):
        open_prior([str(geojson(tmp_path / "a.geojson", feature, **members))])


def test_json_that_nests_without_end(tmp_path: Path) -> None:
    (tmp_path / "a.geojson").write_text("[" * 200_000)
    with pytest.raises(InputError, match="can't be read as GeoJSON"):
        open_prior([str(tmp_path / "a.geojson")])


def test_degrees_are_not_taken_for_metres_of_a_local_frame(tmp_path: Path) -> None:
    file = geojson(tmp_path / "a.geojson", square(0, 0, 1, height_m=1))
    with pytest.raises(InputError, match="the map in a frame of its own; say where that lies: --crs"):
        list(open_prior([f"{file}?crs=EPSG:4326"]).deltas(LATTICE, TERRAIN))


def test_a_prior_of_a_country_is_refused_at_once(tmp_path: Path) -> None:
    file = geojson(tmp_path / "a.geojson", square(0, 0, 1_000_000, gps_quality=1))
    with pytest.raises(InputError, match="at most 2e"):
        list(open_prior([str(file)]).deltas(LATTICE, TERRAIN))


def test_two_places_far_apart_name_the_further_one(tmp_path: Path) -> None:
    """Each is small, but the rectangle around them is 1e9 cells by 5."""
    near = [square(10 * k, 0, 5, height_m=1) for k in range(5)]
    file = geojson(tmp_path / "a.geojson", *near, square(1e9, 0, 5, height_m=1))
    with pytest.raises(
        InputError, match=r"a\.geojson: feature 6, 1000000000 to 1000000005 east and 0 to 5 north, lies 1e\+06"
    ):
        list(open_prior([str(file)]).deltas(LATTICE, TERRAIN))
    other = geojson(tmp_path / "b.geojson", square(1e8, 1e8, 5, height_m=1))
    few = geojson(tmp_path / "c.geojson", *near)
    with pytest.raises(
        InputError, match=r"b\.geojson: feature 1, .* km from the rest: the map would be a raster of 1e\+16"
    ):
        list(open_prior([str(few), str(other)]).deltas(LATTICE, TERRAIN))
    with pytest.raises(InputError, match=r"c\.geojson: feature 1, .* from where r1 and r2 begin"):
        open_prior([str(few)]).placed(LATTICE, {"r1": (1e6, 1e6), "r2": (1e6, 1e6)})
    assert open_prior([str(few)]).placed(LATTICE, {"r1": (1000.0, 1000.0)})


def test_places_that_the_maps_crs_does_not_have_name_the_file(tmp_path: Path) -> None:
    """UTM's formulas end about 90° from the middle of the zone, 9° east: infinity."""
    lattice = Lattice(1.0, 10.0, "EPSG:32632")
    file = geojson(tmp_path / "a.geojson", square(9, 45, 0.001, height_m=1), square(99, 0, 0.1, height_m=1))
    with pytest.raises(InputError, match=r"a\.geojson: feature 2: .* in EPSG:4326 has no place in EPSG:32632"):
        list(open_prior([f"{file}?crs=EPSG:4326"]).deltas(lattice, TERRAIN))
    raster = dem(tmp_path / "dem.tif", np.ones((5, 5)), 94.0, 5.0, "EPSG:4326")
    with pytest.raises(InputError, match=r"dem\.tif: its bounds, 94 to 104 and -5 to 5, have no place in EPSG:32632"):
        list(open_prior([str(raster)]).deltas(lattice, TERRAIN))
    with pytest.raises(InputError, match=r"a\.geojson: CRS 'EPSG:7' is not known"):
        open_prior([f"{file}?crs=EPSG:7"])


WRONG = {
    "confidence": (2, "give a number from 0 to 1"),
    "gps_quality": (9, "give 0 none, 1 single or 2 differential"),
    "communications": (0.5, "give 0 none or 1 there is a link"),
    "height_m": (1e6, "give metres within ±10737"),
}


@pytest.mark.parametrize("name", WRONG)
def test_values_out_of_range_are_named_when_the_file_is_opened(name: str, tmp_path: Path) -> None:
    value, remedy = WRONG[name]
    good = square(0, 0, 5, height_m=1)
    file = geojson(tmp_path / "a.geojson", good, square(0, 0, 5, **({"height_m": 1} | {name: value})))
    with pytest.raises(InputError, match=re.escape(f"a.geojson: feature 2: {name} is {value!r}; {remedy}")):
        open_prior([str(file)])
    bands: dict[str, Array] = {"height": np.full((5, 5), np.nan), name: np.zeros((5, 5))}
    bands[name if name != "height_m" else "height"][2, 3] = value
    if name == "height_m":
        del bands[name]
    raster = dem(tmp_path / "dem.tif", bands.pop("height"), 0.0, 10.0, **bands)
    with pytest.raises(
        InputError, match=rf"dem\.tif: band '.*', {name}, is .* at row 3, column 4; {re.escape(remedy)}"
    ):
        open_prior([str(raster)])


def test_progress_counts_tiles_and_cells(tmp_path: Path) -> None:
    """Tiles of 10×10 cells; the square covers 1 + ½ of them each way: 15² cells in four tiles."""
    file = geojson(tmp_path / "a.geojson", square(0, 0, 15, height_m=1))
    told: list[tuple[int, int, int]] = []
    list(open_prior([str(file)]).deltas(LATTICE, TERRAIN, lambda *now: told.append(now)))
    assert told == [(1, 4, 100), (2, 4, 150), (3, 4, 200), (4, 4, 225)]


def test_a_large_prior_comes_in_several_deltas_of_tiles_of_their_own(tmp_path: Path) -> None:
    lattice = Lattice(1.0, 100.0)
    file = geojson(tmp_path / "a.geojson", square(0, 0, 1500, communications=1))
    deltas = list(open_prior([str(file)]).deltas(lattice, TERRAIN))
    assert [delta.cell_count for delta in deltas] == [105 * 10_000, 105 * 10_000, 15 * 10_000]
    assert len({tile.key for delta in deltas for tile in delta.tiles}) == 225


def test_rings_of_other_things_than_numbers(tmp_path: Path) -> None:
    for coordinates in ("x", [], [[]], [["ab", "cd", "ef", "gh"]], [[["0", "0"]] * 4], [[[True, False]] * 4],
                        [[[10**400, 0]] * 4], [[{}] * 4], [[[0], [1, 1], [1, 2], [0, 0]]], [[[[0, 0]] * 4] * 4], 7,
                        [[[0, 0], [1, 0], [1, float("nan")], [0, 0]]]):  # fmt: skip
        feature = square(0, 0, 5, height_m=1)
        feature["geometry"]["coordinates"] = coordinates
        with pytest.raises(InputError, match=r"a\.geojson: feature 1: (its coordinates are no rings|a ring needs)"):
            open_prior([str(geojson(tmp_path / "a.geojson", feature))])


def test_bad_options(tmp_path: Path) -> None:
    file = geojson(tmp_path / "a.geojson", square(0, 0, 1, height_m=1))
    for option, message in {
        "confidence=2": "confidence=2: give a number over 0",
        "confidence=x": "confidence=x",
        "colour=red": "no option 'colour'",
    }.items():
        with pytest.raises(InputError, match=message):
            open_prior([f"{file}?{option}"])


def test_each_kind_of_file_takes_its_own_options(tmp_path: Path) -> None:
    polygons = geojson(tmp_path / "a.geojson", square(0, 0, 1, height_m=1))
    with pytest.raises(InputError, match="no option 'band'; there are: confidence, crs"):
        open_prior([f"{polygons}?band=3"])
    stated = dem(tmp_path / "dem.tif", np.ones((5, 5)), 0.0, 10.0, "EPSG:32632")
    with pytest.raises(InputError, match="states its CRS, EPSG:32632"):
        open_prior([f"{stated}?crs=EPSG:32633"])


def test_a_raster_that_states_no_crs_takes_the_one_that_is_said(tmp_path: Path) -> None:
    """UTM 32 and 33 tell the same place by coordinates hundreds of kilometres apart."""
    import pyproj

    lattice = Lattice(1.0, 10.0, "EPSG:32633")
    file = dem(tmp_path / "dem.tif", np.full((5, 5), 7.0), 500_000.0, 5_400_010.0)
    replica = Replica(lattice, TERRAIN)
    for delta in open_prior([f"{file}?crs=EPSG:32632"]).deltas(lattice, TERRAIN):
        replica.apply(delta)
    east, north = pyproj.Transformer.from_crs(32632, 32633, always_xy=True).transform(500_005.0, 5_400_005.0)
    height = replica.layer("height")
    assert abs(float(height.x.mean()) - east) < 1.0
    assert abs(float(height.y.mean()) - north) < 1.0


def test_degrees_on_a_map_of_metres_must_be_said(tmp_path: Path) -> None:
    lattice = Lattice(1.0, 10.0, "EPSG:32632")
    for file in (
        geojson(tmp_path / "a.geojson", square(10.0, 45.0, 0.001, height_m=1)),
        dem(tmp_path / "dem.tif", np.ones((5, 5)), 10.0, 45.0),
    ):
        with pytest.raises(InputError, match=r"lies nowhere near.*crs=EPSG:4326") as error:
            list(open_prior([str(file)]).deltas(lattice, TERRAIN))
        assert str(file) in str(error.value)
    assert list(open_prior([f"{tmp_path / 'a.geojson'}?crs=EPSG:4326"]).deltas(lattice, TERRAIN))


def test_a_file_that_gives_no_cell_is_named(tmp_path: Path) -> None:
    """No cell's centre lies within (0.6, 0.6) to (0.9, 0.9)."""
    some = geojson(tmp_path / "some.geojson", square(0, 0, 5, height_m=1))
    none = geojson(tmp_path / "none.geojson", square(0.6, 0.6, 0.3, height_m=1))
    with pytest.raises(InputError, match=r"none\.geojson: gives no cell"):
        list(open_prior([str(some), str(none)]).deltas(LATTICE, TERRAIN))


def test_values_that_the_model_can_t_hold(tmp_path: Path) -> None:
    file = geojson(tmp_path / "a.geojson", square(0, 0, 1, gps_quality=7))
    with pytest.raises(InputError, match="gps_quality"):
        list(open_prior([str(file)]).deltas(LATTICE, TERRAIN))


def test_the_program_maps_over_a_prior(tmp_path: Path, logs: dict[str, Path]) -> None:
    """Where the robot saw the ground its heights count, elsewhere the prior's; the prior can be left out again."""
    houses = geojson(tmp_path / "houses.geojson", square(-40, 40, 20, height_m=10, communications=1))
    out = tmp_path / "out"
    ran = terrafuse(
        "map", f"r1={logs['r1']}", "--model", "terrain", "--resolution", "0.5", "--prior", houses, "--out", out
    )
    assert ran.code == 0, ran.err
    alone = tmp_path / "alone.npz"
    assert terrafuse("export", out / "map.db", "--out", alone, "--without", "prior").code == 0
    both = tmp_path / "both.npz"
    assert terrafuse("export", out / "map.db", "--out", both).code == 0
    with np.load(both) as b, np.load(alone) as a:
        assert int((b["height"] == 10.0).sum()) == 40 * 40
        assert (a["height"] != 10.0).all()
        assert np.nanmax(a["height"]) < 5.0


def test_the_program_leaves_nothing_of_a_map_that_a_prior_makes_too_large(
    tmp_path: Path, logs: dict[str, Path]
) -> None:
    far = geojson(tmp_path / "far.geojson", square(-40, 40, 20, height_m=10), square(1e7, 1e7, 5, height_m=10))
    away = geojson(tmp_path / "away.geojson", square(1e7, 1e7, 5, height_m=10))
    for file, feature in ((far, 2), (away, 1)):
        ran = terrafuse("map", f"r1={logs['r1']}", "--model", "terrain", "--prior", file, "--out", tmp_path / "out")
        assert ran.code == 2
        assert f"{file}: feature {feature}, 10000000 to 10000005 east and 10000000 to 10000005 north," in ran.err
        assert "from where r1 begins:" in ran.err
        assert not (tmp_path / "out").exists()


def test_the_program_refuses_a_prior_for_a_model_that_takes_none(tmp_path: Path, logs: dict[str, Path]) -> None:
    houses = geojson(tmp_path / "houses.geojson", square(0, 0, 5, height_m=10))
    ran = terrafuse("map", f"r1={logs['r1']}", "--prior", houses, "--out", tmp_path / "out")
    assert ran.code == 2
    assert "takes no prior map; use --model terrain" in ran.err
    named = terrafuse("map", f"prior={logs['r1']}", "--model", "terrain", "--prior", houses, "--out", tmp_path / "out")
    assert named.code == 2
    assert "rename the robot" in named.err
    assert not (tmp_path / "out").exists()


def test_the_pages_example(tmp_path: Path) -> None:
    page = (Path(__file__).parent.parent / "docs" / "prior-maps.md").read_text()
    (example,) = re.findall(r"```json\n(.*?)```", page, re.DOTALL)
    (tmp_path / "example.geojson").write_text(example)
    lattice = Lattice(1.0, 10.0, "EPSG:32632")
    replica = Replica(lattice, TERRAIN)
    for delta in open_prior([str(tmp_path / "example.geojson")]).deltas(lattice, TERRAIN):
        replica.apply(delta)
    assert int((replica.layer("height") == 10.0).sum()) == 20 * 12
    assert int((replica.layer("gps_quality") == 0.0).sum()) > 300
