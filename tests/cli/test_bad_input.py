"""Bad input: a message that names the file, the record and the remedy; exit code 2; nothing half-written."""

from __future__ import annotations

import resource
import signal
import sqlite3
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.program import PROGRAM, Ran, record, terrafuse

FINAL_NAMES = {"map.db", "map.tif", "map.png", "report.html", "report.json"}


def refused(out: Path, *arguments: str | Path, says: tuple[str, ...], **options: Any) -> Ran:
    """Run `map`, and check that it refuses as it should."""
    ran = terrafuse("map", *arguments, "--out", out, **options)
    assert ran.code == 2, (ran.code, ran.out, ran.err)
    assert [line for line in ran.err.splitlines() if line.startswith("error: ")], ran.err
    assert "Traceback" not in ran.err
    for words in says:
        assert words in ran.err
    left = {p.name for p in out.iterdir()} if out.is_dir() else set()
    assert not left & FINAL_NAMES
    assert not [name for name in left if name.endswith((".partial", ".part"))]
    return ran


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out"


def test_missing_file(out: Path, tmp_path: Path) -> None:
    refused(out, f"r1={tmp_path / 'nope.mcap'}", says=("nope.mcap", "no such file"))
    assert not out.exists()


def test_unknown_format(out: Path, tmp_path: Path) -> None:
    (tmp_path / "a.xyzzy").write_bytes(b"\x00\x01\x02")
    refused(out, f"r1={tmp_path / 'a.xyzzy'}", says=("a.xyzzy", "not a recording of a known format", "kitti"))


def test_truncated_log(out: Path, tmp_path: Path, logs: dict[str, Path]) -> None:
    whole = logs["r1"].read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    refused(out, f"r1={tmp_path / 'cut.mcap'}", says=("cut.mcap",))


def test_clouds_without_poses(out: Path, tmp_path: Path) -> None:
    (tmp_path / "clouds").mkdir()
    np.save(tmp_path / "clouds/1.0.npy", np.zeros((5, 3)))
    refused(out, f"r1={tmp_path / 'clouds'}", says=("clouds", "poses="))


def test_a_cloud_of_nan(out: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "nothing.npy", np.full((7, 3), np.nan))
    refused(
        out,
        f"r1={tmp_path / 'nothing.npy'}?poses=identity",
        says=("nothing.npy", "7 not finite", "check its poses and points"),
    )
    assert not out.exists()


def test_folders_that_were_there_stay(out: Path, tmp_path: Path) -> None:
    """Of new ones the parents go, too; what held something keeps it."""
    np.save(tmp_path / "nothing.npy", np.full((7, 3), np.nan))
    source = f"r1={tmp_path / 'nothing.npy'}?poses=identity"
    refused(out / "deep/er", source, says=("nothing.npy",))
    assert not out.exists()
    out.mkdir()
    refused(out, source, says=("nothing.npy",))
    assert list(out.iterdir()) == []


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("nan 0 0 0 0 1 0 0 0 0 1 0", "NaN"),
        ("2 0 0 0 0 1 0 0 0 0 1 0", "not a rigid motion"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0", "not a rigid motion"),
        ("1 0 0 0 0 1", "poses.txt"),
    ],
)
def test_bad_poses(out: Path, tmp_path: Path, row: str, says: str) -> None:
    for k in range(2):
        np.zeros((4, 4), np.float32).tofile(tmp_path / f"{k:06}.bin")
    (tmp_path / "poses.txt").write_text(f"1 0 0 0 0 1 0 0 0 0 1 0\n{row}\n")
    refused(out, f"r1={tmp_path}?reader=kitti&poses=poses.txt&calib=identity", says=("poses.txt", says))


def kitti_folder(folder: Path, seconds: list[float]) -> str:
    """A KITTI folder of small scans at these times, all from one place."""
    folder.mkdir()
    for k, _ in enumerate(seconds):
        points = np.random.default_rng(k).normal(0, 5, (50, 4)).astype(np.float32)
        points.tofile(folder / f"{k:06}.bin")
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * len(seconds))
    (folder / "times.txt").write_text("".join(f"{t}\n" for t in seconds))
    return f"r1={folder}?calib=identity"


def test_stamps_that_run_backwards(out: Path, tmp_path: Path) -> None:
    source = kitti_folder(tmp_path / "back", [0.0, 0.1, 0.3, 0.2])
    refused(out, source, says=("back", "record 4", "backwards=drop"))
    ran = terrafuse("map", f"{source}&backwards=drop", "--out", out, "--json")
    assert ran.code == 0, ran.err
    assert sum(ran.json["robots"]["r1"]["skipped"].values()) == 1


def test_a_fault_late_in_a_log_keeps_what_was_mapped(out: Path, tmp_path: Path) -> None:
    """The message says where; the work until there stays in map.partial.db."""
    source = kitti_folder(tmp_path / "late", [0.1 * k for k in range(50)] + [0.0])
    refused(out, source, says=("late", "backwards=drop"))
    assert [p.name for p in out.iterdir()] == ["map.partial.db"]
    ran = terrafuse("map", f"{source}&backwards=drop", "--out", out, "--json")
    assert ran.code == 0, ran.err
    assert ran.json["robots"]["r1"]["resumed_scans"] > 0


def test_other_poses_are_another_run(out: Path, tmp_path: Path) -> None:
    """An edited trajectory of the same size must not be mixed into what was mapped with the first."""
    source = kitti_folder(tmp_path / "log", [0.1 * k for k in range(50)] + [0.0])
    refused(out, source, says=("backwards=drop",))
    poses = tmp_path / "log/poses.txt"
    poses.write_text(poses.read_text().replace("1 0 0 0 0 1 0 0 0 0 1 0", "1 0 0 5 0 1 0 0 0 0 1 0"))
    refused(out, f"{source}&backwards=drop", says=("of a run with other logs", "--overwrite"))
    assert terrafuse("map", f"{source}&backwards=drop", "--out", out, "--overwrite").code == 0


def test_a_name_given_twice(out: Path, logs: dict[str, Path]) -> None:
    refused(out, f"r1={logs['r1']}", f"r1={logs['r2']}", says=("robot 'r1' is given twice",))


def test_a_log_without_a_name(out: Path, logs: dict[str, Path]) -> None:
    refused(out, logs["r1"], says=("give each log a robot's name",))


def test_a_resolution_that_does_not_divide_the_tile(out: Path, logs: dict[str, Path]) -> None:
    says = ("0.3 m does not divide the tile of 40", "0.300752")
    refused(out, f"r1={logs['r1']}", "--resolution", "0.3", "--tile", "40", says=says)


@pytest.mark.parametrize("option", ["--resolution", "--tile", "--max-range"])
@pytest.mark.parametrize("value", ["0", "-1", "nan"])
def test_impossible_lengths(out: Path, logs: dict[str, Path], option: str, value: str) -> None:
    refused(out, f"r1={logs['r1']}", option, value, says=(f"{option} {value}: give a number of metres over 0",))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--static", "--model", "grey"], "--static: the model 'grey' has no such setting; it is one of elevation"),
        (["--max-range", "9", "--model", "grey"], "it is one of elevation, occupancy, terrain"),
        (["--max-range", "9", "--model", "terrain?max_range_m=8"], "--max-range and --model terrain?max_range_m=8 set"),
        (["--model", "terrain?halflife=60"], "the model 'terrain' has no setting 'halflife'; it has: max_slope"),
        (["--model", "terrain?subcells=many"], "the model 'terrain': subcells=many: give a whole number"),
        (["--model", "terrain?max_slope=-1"], "--model terrain?max_slope=-1: max_slope -1.0: give a positive number"),
        (["--model", "terrain?max_slope"], "'max_slope' after the '?' is not key=value"),
        (["--model", "elevatoin?static=true"], "no cell model 'elevatoin'; there are: elevation, grey"),
        (["--sensor", ""], "--sensor '': names nothing; give a file, or NAME=FILE"),
        (["--sensor", "r1="], "--sensor 'r1=': names nothing"),
        (["--origin", "5"], "--origin '5': give 2 finite numbers, EAST,NORTH"),
    ],
)
def test_options_that_cannot_be(out: Path, logs: dict[str, Path], arguments: list[str], says: str) -> None:
    refused(out, f"r1={logs['r1']}", *arguments, says=(says,))
    assert not out.exists()


@pytest.mark.parametrize("command", [["info"], ["export", "--out", "a.tif"], ["plan", "--from", "0,0", "--to", "1,1"]])
def test_a_folder_in_the_place_of_its_store(mapped: Path, tmp_path: Path, command: list[str]) -> None:
    ran = terrafuse(command[0], mapped, *command[1:], cwd=tmp_path)
    assert ran.code == 2
    assert f"{mapped}: is a folder; give the store in it: {mapped / 'map.db'}" in ran.err
    assert "is a folder; give a store, like map/map.db" in terrafuse(command[0], tmp_path, *command[1:]).err


def test_mixed_crs(out: Path, tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    pyproj = pytest.importorskip("pyproj")
    for name, epsg in (("a", 32632), ("b", 32633)):
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.add_crs(pyproj.CRS.from_epsg(epsg))
        header.scales = [0.01] * 3
        las = laspy.LasData(header)
        las.x, las.y, las.z = np.array([500_000.0]), np.array([4_000_000.0]), np.array([10.0])
        las.write(tmp_path / f"{name}.las")
    both = [f"{name}={tmp_path / name}.las" for name in "ab"]
    refused(out, *both, says=("mixed CRS", "a.las", "b ("))
    refused(out, both[0], "--crs", "EPSG:25832", says=("mixed CRS",))
    assert terrafuse("map", both[0], "--crs", "EPSG:32632", "--out", out).code == 0


@pytest.mark.parametrize(("crs", "says"), [("EPSG:4326", "does not count metres"), ("EPSG:99999999", "is not known")])
def test_impossible_crs(out: Path, logs: dict[str, Path], crs: str, says: str) -> None:
    refused(out, f"r1={logs['r1']}", "--crs", crs, says=(crs, says))


def test_a_local_log_needs_an_origin_beside_a_georeferenced_one(
    out: Path, logs: dict[str, Path], recordings: Path
) -> None:
    las = recordings / "airborne/pdal/autzen_trim.laz"
    refused(out, f"r1={logs['r1']}", f"air={las}", says=("r1", "--origin EAST,NORTH"))


@pytest.mark.parametrize("limit_kb", [40, 600], ids=["in the store", "in the raster"])
def test_a_full_disk(tmp_path: Path, out: Path, limit_kb: int) -> None:
    """A limit on the size of files stands in for the disk: writes fail in the middle, as they do there."""
    log = record(tmp_path / "a.mcap", 1, 30, points=8000 if limit_kb < 100 else 3000)

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit_kb << 10, limit_kb << 10))

    refused(out, f"r1={log}", "--resolution", "0.1", preexec_fn=limit, says=(str(out), "free some space"))
    ran = terrafuse("map", f"r1={log}", "--resolution", "0.1", "--out", out)  # with space it goes on
    assert ran.code == 0, ran.err


def test_an_unwritable_folder(tmp_path: Path, logs: dict[str, Path]) -> None:
    (tmp_path / "file").write_text("in the way")
    for folder in (tmp_path / "file/out", Path("/proc/terrafuse")):
        refused(folder, f"r1={logs['r1']}", says=(str(folder), "choose another --out"))


def test_a_store_of_a_newer_schema(mapped: Path, tmp_path: Path) -> None:
    copy = tmp_path / "map.db"
    copy.write_bytes((mapped / "map.db").read_bytes())
    with sqlite3.connect(copy) as connection:
        connection.execute("PRAGMA user_version = 4")
    for command in (["info", copy], ["export", copy, "--out", tmp_path / "a.tif"]):
        ran = terrafuse(*command)
        assert ran.code == 2
        assert "map.db: store schema 4 is newer than 3" in ran.err
        assert "pip install -U terrafuse" in ran.err
    assert not (tmp_path / "a.tif").exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--layer", "hieght"], "no layer 'hieght'; it has: height"),
        (["--bounds", "1,2,3"], "give 4 finite numbers"),
        (["--bounds=-inf,-inf,inf,inf"], "give 4 finite numbers"),
        (["--bounds", "5000,5000,5010,5010"], "nothing of the map lies within"),
        (["--bounds", "3,2,1,4"], "the bounds are empty"),
        (["--only", "r9"], "no robot 'r9'"),
    ],
)
def test_export_refuses(mapped: Path, tmp_path: Path, arguments: list[str], says: str) -> None:
    ran = terrafuse("export", mapped / "map.db", "--out", tmp_path / "a.tif", *arguments)
    assert ran.code == 2
    assert says in ran.err
    assert list(tmp_path.iterdir()) == []


def test_export_to_an_unknown_ending(mapped: Path, tmp_path: Path) -> None:
    ran = terrafuse("export", mapped / "map.db", "--out", tmp_path / "a.bmp")
    assert ran.code == 2
    assert "cog" in ran.err


def test_errors_as_json(tmp_path: Path) -> None:
    ran = terrafuse("info", tmp_path / "nope.db", "--json")
    assert ran.code == 2
    assert ran.json["exit_code"] == 2
    assert "nope.db: no such store" in ran.json["error"]


@pytest.mark.parametrize(
    "arguments", [["map"], ["info"], ["map", "r1=x", "--out", "o", "--resolution", "abc"], ["nope"]]
)
def test_wrong_options_as_json(arguments: list[str]) -> None:
    ran = terrafuse(*arguments, "--json")
    assert ran.code == 2
    assert ran.json["exit_code"] == 2
    assert ran.json["error"]


def test_a_store_is_not_exported_onto_itself(mapped: Path, tmp_path: Path) -> None:
    copy = tmp_path / "map.db"
    copy.write_bytes((mapped / "map.db").read_bytes())
    ran = terrafuse("export", copy, "--out", copy, "--format", "npz")
    assert ran.code == 2
    assert "the store itself" in ran.err
    assert copy.read_bytes() == (mapped / "map.db").read_bytes()


def test_damaged_stores(mapped: Path, tmp_path: Path) -> None:
    copy = tmp_path / "map.db"
    copy.write_bytes((mapped / "map.db").read_bytes()[:20_000])
    ran = terrafuse("info", copy)
    assert ran.code == 2
    assert "map.db: damaged" in ran.err
    copy.write_bytes((mapped / "map.db").read_bytes())
    with sqlite3.connect(copy) as connection:
        connection.execute("UPDATE meta SET value = '{' WHERE name = 'map'")
    ran = terrafuse("info", copy)
    assert ran.code == 2
    assert "map.db: damaged" in ran.err


def test_outliers_name_their_remedy(out: Path, tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(0, 5, (1000, 3))
    points[:2] = [[2e6, 0, 0], [0, 3e6, 0]]
    np.save(tmp_path / "far.npy", points)
    source = f"r1={tmp_path / 'far.npy'}?poses=identity"
    refused(out, source, says=("--max-range",))
    ran = terrafuse("map", source, "--max-range", "1000", "--out", out, "--overwrite", "--json")
    assert ran.code == 0, ran.err
    assert ran.json["robots"]["r1"]["dropped"] == {"beyond max_range_m": 2}


def test_interrupting_says_that_the_work_is_kept(out: Path, tmp_path: Path) -> None:
    log = record(tmp_path / "long.mcap", 1, 1200, points=4000)
    # Who runs tests in a shell's background has them ignore interrupts, and so what they start.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    process = subprocess.Popen(
        [*PROGRAM, "map", f"r1={log}", "--out", str(out)], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    signal.signal(signal.SIGINT, before)
    while not (out / "map.partial.db").exists():
        time.sleep(0.01)
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "the same command goes on from there" in said
    assert not FINAL_NAMES & {p.name for p in out.glob("*")}


def test_wrong_options_are_wrong_use() -> None:
    assert terrafuse("map").code == 2
    assert terrafuse("frobnicate").code == 2
    assert terrafuse("--help").code == 0
    assert terrafuse("--version").out.strip().startswith("0.")
