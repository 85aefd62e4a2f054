"""YAML → Sensor: every key, every preset, every complaint."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from terrafuse.errors import InputError
from terrafuse.sense import Beams, Mounting, Ring, Sensor, load_sensor, preset_names
from terrafuse.sense.describe import content, read_sensor

WHOLE = """\
name: front sonars
ring:
  count: 3
  first_deg: -45
  step_rad: 0.7853981633974483
  counting: clockwise
  radius_m: 0.2
  elevations_deg: [10, -10]
max_range_m: 5
min_range_m: 0.2
no_return: clear
sentinels_m: {0: ignore, 5.11: clear}
origin_m: [0, 0, 1]
cone_half_angle_deg: 15
range_error_m: 0.05
noise_sigma_m: 0.01
reliability: 0.9
firing_period_s: 0.04
mounting: {x_m: 0.1, y_m: -0.2, z_m: 0.3, roll_deg: 180, pitch_rad: 0.1, yaw_deg: 90}
"""


def test_every_key() -> None:
    rad = math.radians
    assert read_sensor(WHOLE, "here") == Sensor(
        name="front sonars",
        max_range_m=5.0,
        min_range_m=0.2,
        no_return="clear",
        sentinels_m=((0.0, "ignore"), (5.11, "clear")),
        beams=Ring(3, rad(-45), 0.7853981633974483, True, 0.2, (rad(10), rad(-10))),
        origin_m=(0.0, 0.0, 1.0),
        cone_half_angle_rad=rad(15),
        range_error_m=0.05,
        noise_sigma_m=0.01,
        reliability=0.9,
        firing_period_s=0.04,
        mounting=Mounting(0.1, -0.2, 0.3, math.pi, 0.1, rad(90)),
    )


def test_little_is_needed() -> None:
    assert read_sensor("name: lidar\nmax_range_m: 30\n", "here") == Sensor("lidar", 30.0)
    whole_turn = read_sensor("name: r\nmax_range_m: 3\nring: {count: 8}\n", "here").beams
    assert whole_turn == Ring(8, 0.0, math.tau / 8)
    listed = read_sensor("name: r\nmax_range_m: 3\nbeams: {azimuths_deg: [0, 90], radius_m: 1}\n", "here").beams
    assert listed == Beams((0.0, math.pi / 2), (0.0, 0.0), 1.0)


@pytest.mark.parametrize("name", preset_names())
def test_presets_load(name: str) -> None:
    sensor = load_sensor(name)
    assert sensor.name == name
    assert sensor.beam.max_range_m == sensor.max_range_m


def test_the_presets_that_there_are() -> None:
    assert {"nomad_200_sonar", "soccer_robot_sonar", "summit_xl_lidar", "scitos_g5_sonar"} <= set(preset_names())
    assert {"sick_lms_180", "sick_lms_361", "sick_lms_181_8m", "velodyne_hdl_64e", "av2_lidars"} <= set(preset_names())


@pytest.mark.parametrize(("beams", "last"), [(180, 89), (181, 90), (360, 89.5), (361, 90)])
def test_sick_beams(beams: int, last: float) -> None:
    azimuths, _ = load_sensor(f"sick_lms_{beams}").beams.angles()
    assert len(azimuths) == beams
    assert np.rad2deg(azimuths[[0, -1]]).tolist() == pytest.approx([-90, last])


def test_a_velodynes_beams() -> None:
    """64 elevations from 2° to -24.33° for each of 2000 azimuths."""
    azimuths, elevations = load_sensor("velodyne_hdl_64e").beams.angles()
    assert len(azimuths) == 128_000
    assert np.rad2deg(elevations[[0, 63, 64]]).tolist() == pytest.approx([2, -24.33, 2])


def refuses(text: str, *parts: str) -> None:
    with pytest.raises(InputError) as caught:
        read_sensor(text, "my.yaml")
    for part in parts:
        assert part in str(caught.value), str(caught.value)


BASE = "name: s\nmax_range_m: 10\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("colour: red", "my.yaml:3: colour: there is no such key; known here: name, max_range_m"),
        ("ring: {count: 4, first: 0}", "my.yaml:3: ring.first: there is no such key; known here: count, first_deg"),
        ("ring:\n  count: 4\n  azimuth_deg: 3", "my.yaml:5: ring.azimuth_deg: there is no such key"),
        ("min_range_m: -1", "my.yaml:3: min_range_m = -1: input should be greater than or equal to 0"),
        ("min_range_m: 10", "my.yaml:1: min_range_m 10 is not below max_range_m 10"),
        ("min_range_m: .nan", "my.yaml:3: min_range_m = nan: input should be a finite number"),
        ("noise_sigma_m: .inf", "my.yaml:3: noise_sigma_m = inf: input should be a finite number"),
        ("min_range_m: wide", "my.yaml:3: min_range_m = 'wide': input should be a valid number"),
        ("reliability: 1.5", "my.yaml:3: reliability = 1.5: input should be less than or equal to 1"),
        ("no_return: maybe", "my.yaml:3: no_return = 'maybe': input should be 'clear' or 'ignore'"),
        ("sentinels_m: {5.0: maybe}", "my.yaml:3: sentinels_m.5.0 = 'maybe': input should be 'clear' or 'ignore'"),
        ("sentinels_m: {.nan: clear}", "my.yaml:3: not a key"),
        ("sentinels_m: {1.0: clear, 1.00: ignore}", "my.yaml:3: '1.00' is given twice; keep one"),
        ("min_range_m: true", "my.yaml:3: min_range_m = True: input should be a valid number"),
        ("ring: {count: true}", "my.yaml:3: ring.count = True: input should be a valid integer"),
        ("mounting:\n  x_m: " + "[" * 5000, "my.yaml:4: nests deeper than 32 levels"),
        ("1: 2", "my.yaml:3: 1: there is no such key"),
        ("sentinels_m: [5.0]", "my.yaml:3: sentinels_m = [5.0]: input should be a valid dictionary"),
        ("ring: {radius_m: 1}", "my.yaml:3: ring.count: is missing; add it"),
        ("ring: {count: 0}", "my.yaml:3: ring.count = 0: input should be greater than 0"),
        ("ring: {count: 2.5}", "my.yaml:3: ring.count = 2.5: input should be a valid integer"),
        ("ring: {count: 4, step_deg: -90}", "my.yaml:3: ring.step_deg = -90: input should be greater than 0"),
        ("ring: {count: 4, step_deg: 130}", "4 beams, one each 130°, go round more than once"),
        ("ring: {count: 4, first_rad: 90}", "first of 90 is more than a whole turn; in degrees it is first_deg"),
        ("ring: {count: 4, first_deg: 700}", "first of 700 is more than a whole turn; give it between -360 and 360"),
        ("ring: {count: 4, first_deg: 1, first_rad: 1}", "first_deg and first_rad are both given; keep one"),
        ("ring: {count: 4, first_deg: 1 rad}", "ring.first_deg = '1 rad': input should be a valid number"),
        ("ring: {count: 4, elevations_deg: [100]}", "elevation 100°; give it between -90° and 90°"),
        ("ring: {count: 4}\nbeams: {azimuths_deg: [0]}", "both 'ring' and 'beams' are given"),
        ("ring: {count: 9999999, elevations_deg: [0, 1]}", "9999999 × 2 beams are more than"),
        ("beams: {}", "my.yaml:3: beams = {}: no azimuths; give azimuths_deg, one a beam"),
        ("beams: {azimuths_deg: [0, 1], elevations_deg: [2]}", "2 azimuths and 1 elevations; give one of each a beam"),
        ("beams: {azimuths_deg: [0, x]}", "my.yaml:3: beams.azimuths_deg.1 = 'x': input should be a valid number"),
        ("cone_half_angle_deg: 15", "a cone needs a range_error_m over 0"),
        ("cone_half_angle_deg: 90\nrange_error_m: 1", "cone_half_angle of 90°; give it below 90°"),
        ("mounting: {yaw: 90}", "my.yaml:3: mounting.yaw: there is no such key; known here: x_m, y_m, z_m, roll_deg"),
        ("mounting: 5", "my.yaml:3: mounting = 5"),
        ("origin_m: [1, 2]", "my.yaml:3: origin_m"),
        ("max_range_m: 5", "my.yaml:3: 'max_range_m' is given twice; keep one"),
        ("ring:\n  count: 4\n  count: 5", "my.yaml:5: 'count' is given twice; keep one"),
    ],
)
def test_complaints(text: str, message: str) -> None:
    refuses(BASE + text + "\n", message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "my.yaml: holds no keys"),
        ("just words", "my.yaml: holds no keys"),
        ("- a\n- b\n", "my.yaml: holds no keys"),
        ("name: s", "my.yaml:1: max_range_m: is missing; add it"),
        ("name: s\n  max: [\n", "my.yaml:2: not YAML"),
        ("a: b: c", "my.yaml:1: not YAML"),
        ("name: !!python/object:os.system x\nmax_range_m: 1", "my.yaml:1: the tag"),
        ("name: s\nmax_range_m: 2001-99-99", "my.yaml:2: max_range_m = '2001-99-99': input should be a valid number"),
        ("\x00\x01", "my.yaml"),
        ("a: &a {b: *a}", "my.yaml:1: the anchor &a"),
    ],
)
def test_what_is_no_description(text: str, message: str) -> None:
    refuses(text, message)


def test_a_name_that_there_is_none_of_lists_the_presets() -> None:
    with pytest.raises(InputError) as caught:
        load_sensor("sick_lms")
    message = str(caught.value)
    assert "sensor 'sick_lms': neither a file nor a preset" in message
    assert all(name in message for name in preset_names())


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "my.yaml"
    path.write_text(BASE)
    assert load_sensor(str(path)) == load_sensor(path) == Sensor("s", 10.0)
    path.write_text(BASE + "oops: 1\n")
    with pytest.raises(InputError, match=f"{path}:3: oops"):
        load_sensor(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="can't be read as text"):
        load_sensor(path)
    with pytest.raises(InputError, match="can't be read as text"):
        load_sensor(tmp_path)
    with pytest.raises(InputError, match="neither a file nor a preset"):
        load_sensor("a" * 5000)


def test_the_content_tells_sensors_apart_and_is_json() -> None:
    one, same = read_sensor(WHOLE, "a"), read_sensor(WHOLE.replace("5.11", "5.110"), "b")
    assert content(one) == content(same)
    for changed in ("radius_m: 0.3", "counting: anticlockwise", "max_range_m: 6", "{0: clear"):
        key = changed.split(":")[0]
        line = next(line for line in WHOLE.splitlines() if key in line)
        other = WHOLE.replace("{0: ignore", changed) if key == "{0" else WHOLE.replace(line.strip(), changed)
        assert content(read_sensor(other, "c")) != content(one), changed
