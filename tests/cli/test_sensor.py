"""`terrafuse map --sensor`, as users run it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from terrafuse import mapping
from terrafuse.config import map_settings
from terrafuse.errors import InputError
from tests.program import Ran, terrafuse

pytest.importorskip("rasterio")


def run(logs: dict[str, Path], out: Path, *more: str | Path) -> Ran:
    robots = (f"{name}={log}" for name, log in logs.items())
    return terrafuse("map", *robots, "--resolution", "0.5", "--out", out, "--json", *more)


def described(folder: Path, text: str, name: str = "my.yaml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_the_report_names_the_sensor_and_counts_what_it_drops(logs: dict[str, Path], tmp_path: Path) -> None:
    short = described(tmp_path, "name: short lidar\nmax_range_m: 10\n")
    ran = run(logs, tmp_path / "out", "--sensor", short, "--sensor", "r2=velodyne_hdl_64e")
    assert ran.code == 0, ran.err
    r1, r2 = (ran.json["robots"][name] for name in ("r1", "r2"))
    assert (r1["sensor"], r2["sensor"]) == ("short lidar", "velodyne_hdl_64e")
    assert r1["points"] == r2["points"] == 80_000
    # of a square of 40 m a disc of 10 m, lowered by the 2 m of height, is π·(100 - 4)/1600 = 18.8 %
    assert r1["dropped"]["no return"] / 80_000 == pytest.approx(1 - 0.188, abs=0.01)
    assert sum(r2["dropped"].values()) < 500  # nearer than 0.9 m is only the top of a block underneath
    assert "short lidar" in (tmp_path / "out" / "report.html").read_text()


def test_without_a_sensor_none_is_named(mapped: Path) -> None:
    assert '"sensor": null' in (mapped / "report.json").read_text()


def test_a_mounting_lifts_the_map(logs: dict[str, Path], tmp_path: Path) -> None:
    """The reader's pose counts as the base's: a sensor 1.5 m further up has seen everything 1.5 m further up."""
    lifted = described(tmp_path, "name: mast\nmax_range_m: 100\nmounting: {z_m: 1.5}\n")
    flat = described(tmp_path, "name: mast\nmax_range_m: 100\n", "flat.yaml")
    one = {"r1": logs["r1"]}
    low = run(one, tmp_path / "low", "--sensor", f"r1={flat}").json["layers"]
    high = run(one, tmp_path / "high", "--sensor", f"r1={lifted}").json["layers"]
    for layer in ("z_min", "z_max"):
        assert high[layer]["min"] - low[layer]["min"] == pytest.approx(1.5, abs=1e-5)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("r3=sick_lms_180", "--sensor r3=sick_lms_180: there is no robot 'r3'; there are r1, r2"),
        (
            "r1=nothing.yaml",
            "sensor 'nothing.yaml': neither a file nor a preset; give a YAML file, or one of av2_lidars",
        ),
        ("sick", "nomad_200_sonar, scitos_g5_sonar"),
    ],
)
def test_options_that_cannot_be(logs: dict[str, Path], tmp_path: Path, option: str, message: str) -> None:
    ran = run(logs, tmp_path / "out", "--sensor", option)
    assert ran.code == 2
    assert message in ran.json["error"]
    assert not (tmp_path / "out").exists()


def test_two_for_one(logs: dict[str, Path], tmp_path: Path) -> None:
    twice = run(logs, tmp_path / "out", "--sensor", "r1=av2_lidars", "--sensor", "r1=velodyne_hdl_64e")
    assert "--sensor is given twice for robot 'r1' (av2_lidars and velodyne_hdl_64e); keep one" in twice.json["error"]
    twice = run(logs, tmp_path / "out", "--sensor", "av2_lidars", "--sensor", "velodyne_hdl_64e")
    assert "--sensor is given twice for all robots" in twice.json["error"]


def test_a_file_with_a_fault(logs: dict[str, Path], tmp_path: Path) -> None:
    path = described(tmp_path, "name: s\nmax_range: 10\n")
    ran = run(logs, tmp_path / "out", "--sensor", path)
    assert ran.code == 2
    assert f"{path}:" in ran.json["error"]


def test_help_says_where_presets_are_listed() -> None:
    assert "docs/sensors.md" in terrafuse("map", "--help").out


def test_a_cut_run_goes_on_only_with_the_same_sensor(logs: dict[str, Path], tmp_path: Path) -> None:
    def fingerprint(text: str, name: str) -> object:
        path = described(tmp_path, text, name)
        return mapping.plan({"r1": str(logs["r1"])}, map_settings(sensors={"r1": str(path)})).fingerprint

    first = fingerprint("name: s\nmax_range_m: 10\n", "a.yaml")
    assert first == fingerprint("# moved, and written otherwise\nmax_range_m: 10.0\nname: s\n", "b.yaml")
    assert first != fingerprint("name: s\nmax_range_m: 11\n", "a.yaml")
    assert first != mapping.plan({"r1": str(logs["r1"])}, map_settings()).fingerprint


def test_a_cut_run_with_a_sensor_is_finished(logs: dict[str, Path], tmp_path: Path) -> None:
    """Its store holds the description: opened again, it is the same run."""
    settings = map_settings(sensors={"r1": "nomad_200_sonar"})
    plan = mapping.plan({"r1": str(logs["r1"])}, settings)
    mapping.open_partial(tmp_path / "map.db", plan).close()
    mapping.open_partial(tmp_path / "map.db", plan).close()


def test_points_in_the_maps_frame_have_no_sensor(tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    las = laspy.create(point_format=1, file_version="1.2")
    las.header.scales = [0.01] * 3
    las.x = las.y = las.z = np.arange(10.0)
    las.write(str(tmp_path / "tile.las"))
    settings = map_settings(sensors={"air": "av2_lidars"})
    with pytest.raises(InputError, match=r"air: .*tile.las holds points in the map's frame, not a sensor's readings"):
        mapping.plan({"air": f"{tmp_path / 'tile.las'}?crs=EPSG:32632"}, settings)


def test_silent_beams_of_a_log_are_counted(tmp_path: Path) -> None:
    """180 beams, 10 of them silent, in each of 3 scans: counted; and cleared ways where the sensor says so."""
    ranges = " ".join(["3.0"] * 170 + ["81.83"] * 10)
    lines = [f"FLASER 180 {ranges} 0.1 0.1 0 0 0 0 {stamp} host 1" for stamp in (1, 2, 3)]
    log = described(tmp_path, "\n".join(lines) + "\n", "a.log")
    clear = described(tmp_path, "name: c\nmax_range_m: 30\nno_return: clear\n")
    undescribed = run({"r1": log}, tmp_path / "a").json
    preset = run({"r1": log}, tmp_path / "b", "--sensor", "sick_lms_180").json
    cleared = run({"r1": log}, tmp_path / "c", "--sensor", clear).json
    assert undescribed["robots"]["r1"]["dropped"] == preset["robots"]["r1"]["dropped"] == {"no return": 30}
    assert cleared["robots"]["r1"]["dropped"] == {}
    assert undescribed["map"]["digest"] == preset["map"]["digest"] == cleared["map"]["digest"]  # heights are the same


RING = "name: four\nmax_range_m: 3\nno_return: clear\nring: {count: 4, radius_m: 0.1}\ncone_half_angle_deg: 12\n"


def table(folder: Path) -> Path:
    """A robot of four sonars drives ahead along a wall, 1.05 m to its left."""
    lines = [f"{k},{0.1 * k:.1f},0,0,inf,0.95,3.5,inf" for k in range(20)]
    return described(folder, "stamp_s,x_m,y_m,yaw_rad,r0_m,r1_m,r2_m,r3_m\n" + "\n".join(lines), "ring.csv")


@pytest.mark.parametrize(("model", "layer"), [("occupancy", "occupancy"), ("grey", "white")])
def test_a_table_of_a_sonars_ring(tmp_path: Path, model: str, layer: str) -> None:
    ring = described(tmp_path, RING + "range_error_m: 0.05\n")
    ran = run({"r1": table(tmp_path)}, tmp_path / "out", "--model", model, "--sensor", ring, "--resolution", "0.1")
    assert ran.code == 0, ran.err
    assert ran.json["robots"]["r1"]["points"] == 20
    npz = tmp_path / "map.npz"
    assert terrafuse("export", tmp_path / "out/map.db", "--out", npz, "--bounds", "0,0,2,2").code == 0
    with np.load(npz) as arrays:
        (column,) = np.flatnonzero(np.isclose(arrays["x"], 1.05))
        value = dict(zip(arrays["y"].round(2).tolist(), arrays[layer][:, column].tolist(), strict=True))
    assert value[0.55] < 0.5 < value[1.05]  # before the wall, and on it
    assert np.isnan(value[1.55])


def test_a_ring_of_another_number_than_the_log(tmp_path: Path) -> None:
    """Said before anything is written, with the log's name and both numbers."""
    logs = {"r1": table(tmp_path)}
    ran = run(logs, tmp_path / "out", "--model", "occupancy", "--sensor", "nomad_200_sonar")
    assert ran.code == 2
    assert f"r1: {logs['r1']}: the log has 4 beams, the sensor nomad_200_sonar has 16" in ran.json["error"]
    assert not (tmp_path / "out").exists()
    none = run(logs, tmp_path / "out", "--model", "occupancy")
    assert (none.code, "nothing says where they look" in none.json["error"]) == (2, True)


def test_a_number_that_changes_within_a_log(tmp_path: Path) -> None:
    lines = [f"FLASER {n} {' '.join(['2.0'] * n)} 0 0 0 0 0 0 {n} host 1" for n in (180, 181)]
    log = described(tmp_path, "\n".join(lines) + "\n", "a.log")
    ran = run({"r1": log}, tmp_path / "out", "--sensor", "sick_lms_180")
    assert ran.code == 2
    assert "a.log: the log has 181 beams, the sensor sick_lms_180 has 180" in ran.json["error"]


def test_a_described_ring_needs_no_field_of_view(tmp_path: Path) -> None:
    """Four beams of an FLASER line, a quarter turn each: 2.2 m ahead, left, behind and right."""
    log = described(tmp_path, "FLASER 4 2.2 2.2 2.2 2.2 0 0 0 0 0 0 1 host 1\n", "a.log")
    ring = described(tmp_path, "name: four\nmax_range_m: 30\nring: {count: 4}\n")
    assert "?fov_deg=" in run({"r1": log}, tmp_path / "out").json["error"]
    facts = run({"r1": log}, tmp_path / "out", "--sensor", ring).json
    assert facts["bounds"] == [-2.5, -2.5, 2.5, 2.5]  # cells of 0.5 m that hold ±2.2
    stated = run({"r1": f"{log}?fov_deg=180"}, tmp_path / "two", "--sensor", ring)
    assert "beam 0 looks to -90.00° in the log, to 0.00° by the sensor four" in stated.json["error"]
