"""Files that were cut, changed or mixed up: whatever is in them, they are taken in, or refused by an InputError."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.imports import import_map
from terrafuse.lattice import Lattice
from terrafuse.models import make_model
from terrafuse.navigate import load_robot
from terrafuse.prior import open_prior
from terrafuse.rosmap import read_map
from terrafuse.sense import load_sensor
from tests.maps import write_raster, write_ros

ROBOT = "radius_m: 0.5\nunknown: forbid\nmax_slope: 0.3\noccupied_from: 0.6\n"
SENSOR = """\
name: front
ring: {count: 3, first_deg: -45, elevations_deg: [10, -10]}
max_range_m: 5
sentinels_m: {0: ignore, 5.11: clear}
mounting: {x_m: 0.1, yaw_deg: 90}
"""
GEOJSON = json.dumps(
    {
        "type": "FeatureCollection",
        "crs": {"type": "name", "properties": {"name": "EPSG:32632"}},
        "features": [
            {
                "type": "Feature",
                "properties": {"height_m": 10, "confidence": 0.1, "gps_quality": 2, "communications": 1},
                "geometry": {"type": "Polygon", "coordinates": [[[0, 0], [8, 0], [8, 8], [0, 8], [0, 0]]]},
            },
            {
                "type": "Feature",
                "properties": {"gps_quality": None},
                "geometry": {"type": "MultiPolygon", "coordinates": [[[[1, 1], [2, 1], [2, 2], [1, 1]]]]},
            },
        ],
    }
).encode()
LATTICE = Lattice(1.0, 10.0, "EPSG:32632")
TOKENS = [
    b"\0", b"[" * 40, b"{", b"}", b"]", b"&a ", b"*a", b"!!set ", b"null", b"true", b"-1", b"1e300", b".inf", b"NaN",
    b"9" * 400, b"\xff\xfe", b"\n", b"\t", b": ", b"- ", b"---\n", b'"', b"'", b"2001-99-99", b"a" * 5000, b"\\ud800",
]  # fmt: skip


@st.composite
def edits(draw: st.DrawFn) -> Callable[[bytes], bytes]:
    """One to three changes: a part is replaced by bytes, by a token, or by another part."""
    parts = draw(st.lists(st.tuples(st.floats(0, 1), st.integers(0, 12)), min_size=1, max_size=3))
    puts = [draw(st.binary(max_size=6) | st.sampled_from(TOKENS) | st.floats(0, 1)) for _ in parts]

    def edited(content: bytes) -> bytes:
        for (share, length), put in zip(parts, puts, strict=True):
            at = int(share * len(content))
            other = content[int(put * len(content)) :][:12] if isinstance(put, float) else put
            content = content[:at] + other + content[at + length :]
        return content

    return edited


def refusal(take: Callable[[], Any]) -> str:
    """What an InputError says, "" for none; anything else leaves."""
    try:
        take()
    except InputError as error:
        return str(error)
    return ""


many = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


@pytest.mark.parametrize(("sound", "load"), [(ROBOT, load_robot), (SENSOR, load_sensor)], ids=["robot", "sensor"])
@many
@given(edit=edits())
def test_descriptions(sound: str, load: Callable[[Path], Any], tmp_path: Path, edit: Callable[[bytes], bytes]) -> None:
    file = tmp_path / "it.yaml"
    file.write_bytes(edit(sound.encode()))
    said = refusal(lambda: load(file))
    assert not said or "it.yaml" in said
    assert len(said) < 1000


@many
@given(edit=edits())
def test_the_yaml_of_ros_maps(tmp_path: Path, edit: Callable[[bytes], bytes]) -> None:
    file = write_ros(tmp_path / "map.yaml", np.arange(16).reshape(4, 4))
    file.write_bytes(edit(file.read_bytes()))
    assert not (said := refusal(lambda: import_map(file, tmp_path / "map.db", overwrite=True))) or "map.yaml" in said


@many
@given(edit=edits(), binary=st.booleans())
def test_images_of_ros_maps(tmp_path: Path, edit: Callable[[bytes], bytes], binary: bool) -> None:
    file = write_ros(tmp_path / "map.yaml", np.arange(256).reshape(16, 16))
    plain = b"P2\n# by hand\n16 16\n255\n" + b" ".join(b"%d" % grey for grey in range(256))
    image = tmp_path / "map.pgm"
    image.write_bytes(edit(image.read_bytes() if binary else plain))
    assert not (said := refusal(lambda: read_map(file))) or "map.pgm" in said


@many
@given(edit=edits())
def test_polygons_known_beforehand(tmp_path: Path, edit: Callable[[bytes], bytes]) -> None:
    file = tmp_path / "a.geojson"
    file.write_bytes(edit(GEOJSON))
    model = make_model("terrain")
    said = refusal(lambda: list(open_prior([str(file)]).deltas(LATTICE, model)))
    assert not said or "a.geojson" in said
    assert len(said) < 1000


@many
@given(edit=edits())
def test_rasters(tmp_path: Path, edit: Callable[[bytes], bytes]) -> None:
    sound, file = tmp_path / "sound.tif", tmp_path / "dem.tif"
    if not sound.exists():
        write_raster(sound, np.arange(16.0).reshape(4, 4), north=4.0, crs="EPSG:32632")
    file.write_bytes(edit(sound.read_bytes()))
    model = make_model("terrain")
    said = refusal(lambda: list(open_prior([str(file)]).deltas(LATTICE, model)))
    assert not said or "dem.tif" in said
    said = refusal(lambda: import_map(file, tmp_path / "map.db", overwrite=True))
    assert not said or "dem.tif" in said
