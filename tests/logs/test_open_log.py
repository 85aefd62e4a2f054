from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import InputError, LogError, MissingExtra
from terrafuse.logs import COMMON_OPTIONS, READERS, Source, open_log, parse_source
from terrafuse.logs.base import Log, Record
from terrafuse.logs.guard import forwards, guarded
from terrafuse.types import Skipped

from .support import NS, refuses, write_tum


def log_of(*records: Record | Exception) -> Log:
    def scans() -> Iterator[Record]:
        for record in records:
            if isinstance(record, Exception):
                raise record
            yield record

    return Log(Path("drive.bag"), "fake", scans)


def stamped(*stamps: int) -> list[Record]:
    return [Skipped(stamp, "a") for stamp in stamps]


def test_a_missing_path_is_named() -> None:
    refuses("/nowhere/drive.bag?topic=/points", "/nowhere/drive.bag: no such file or folder", error=LogError)


def test_a_query_that_is_no_query(tmp_path: Path) -> None:
    refuses(f"{tmp_path}?topic", "'topic' after the '?' is not key=value", error=InputError)


def test_an_unknown_format_lists_the_known_ones(tmp_path: Path) -> None:
    (tmp_path / "a.docx").write_text("hello")
    for path in (tmp_path, tmp_path / "a.docx"):
        message = refuses(str(path), f"{path}: not a recording of a known format", error=LogError)
        for reader in READERS.values():
            assert f"{reader.name}: {reader.summary}" in message


def test_an_unknown_option_lists_the_known_ones(tmp_path: Path) -> None:
    (tmp_path / "a.pcd").write_text("")
    refuses(f"{tmp_path / 'a.pcd'}?pose=x", "reader clouds has no option 'pose'", "poses", "backwards", error=LogError)


def test_the_reader_can_be_chosen(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("1 2 3\n")
    assert open_log(f"{tmp_path / 'a.xyz'}?poses=identity").reader == "clouds"
    refuses(f"{tmp_path / 'a.xyz'}?reader=kitti", "no *.bin here", error=LogError)
    refuses(f"{tmp_path / 'a.xyz'}?reader=mine", "?reader=mine is not one of ros, av2", error=LogError)
    refuses(f"{tmp_path / 'a.xyz'}?poses=identity&backwards=no", "?backwards=no is not one of error, drop")


def test_a_source_is_taken_as_text_is(tmp_path: Path) -> None:
    path = tmp_path / "what?.xyz"
    path.write_text("1 2 3\n")
    assert parse_source(str(path)) == Source(path)
    assert open_log(Source(path, {"poses": "identity"})).count == 1


def test_every_option_has_a_line_of_help() -> None:
    for options in (COMMON_OPTIONS, *(reader.options for reader in READERS.values())):
        assert all(key.strip() and text.strip() and "\n" not in text for key, text in options.items())
    assert list(READERS) == [reader.name for reader in READERS.values()]


def test_stamps_that_run_backwards_are_an_error_by_default() -> None:
    records = guarded(log_of(*stamped(5 * NS, 5 * NS, 4 * NS)), "error", "say so")()
    assert [next(records).stamp_ns, next(records).stamp_ns] == [5 * NS, 5 * NS]
    with pytest.raises(LogError) as caught:
        next(records)
    assert str(caught.value) == (
        "drive.bag: record 3: its stamp 4.000000000 s runs backwards, the one before has 5.000000000 s; say so"
    )


@given(st.lists(st.integers(-5, 5)))
def test_dropping_keeps_every_record_and_a_forward_clock(stamps: list[int]) -> None:
    records = list(forwards(iter(stamped(*stamps)), log_of(), "drop", ""))
    assert [record.stamp_ns for record in records] == stamps
    kept = [record.stamp_ns for record in records if isinstance(record, Skipped) and record.reason == "a"]
    assert kept == sorted(kept)
    assert kept[:1] == stamps[:1]
    assert all(r.reason == "stamp runs backwards" for r in records if isinstance(r, Skipped) and r.reason != "a")


def test_dropping_through_open_log(tmp_path: Path) -> None:
    # times.txt is the one file whose order a reader must take as it is
    (tmp_path / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3)
    (tmp_path / "times.txt").write_text("0.0\n0.2\n0.1\n")
    for i in range(3):
        (tmp_path / f"{i:06d}.bin").write_bytes(bytes(16))
    path = f"{tmp_path}?calib=identity"
    refuses(path, f"{tmp_path}: record 3: its stamp 0.100000000 s runs backwards", "0.200000000 s", "?backwards=drop")
    records = list(open_log(f"{path}&backwards=drop").scans())
    assert records[2] == Skipped(NS // 10, "stamp runs backwards")


@pytest.mark.parametrize("error", [ValueError("bad"), EOFError(), AssertionError(), MemoryError(), OSError("disk")])
def test_damage_names_file_and_record(error: Exception) -> None:
    records = guarded(log_of(*stamped(1), error), "error", "")()
    next(records)
    with pytest.raises(LogError, match=r"^drive\.bag: record 2: truncated or damaged \(") as caught:
        next(records)
    assert caught.value.__cause__ is error


def test_our_own_errors_pass_unchanged() -> None:
    error = LogError("mine")
    with pytest.raises(LogError) as caught:
        list(guarded(log_of(error), "error", "")())
    assert caught.value is error


def test_a_library_that_fails_to_open_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.las"
    path.write_bytes(b"LASF" + bytes(10))
    refuses(str(path), f"{path}: can't be opened as las: truncated or damaged", error=LogError)


@pytest.mark.parametrize(
    ("file", "query", "module", "extra"),
    [
        ("a.bag", "", "rosbags.highlevel", "ros"),
        ("a.las", "", "laspy", "las"),
        ("log", "", "pyarrow.feather", "av2"),
    ],
)
def test_a_missing_library_has_the_line_that_installs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, query: str, module: str, extra: str
) -> None:
    path = tmp_path / file
    if file == "log":
        (path / "sensors" / "lidar").mkdir(parents=True)
        (path / "sensors" / "lidar" / "1.feather").write_bytes(b"")
        (path / "city_SE3_egovehicle.feather").write_bytes(b"")
    else:
        path.write_bytes(b"")
    monkeypatch.setitem(sys.modules, module, None)
    refuses(f"{path}{query}", f"pip install 'terrafuse[{extra}]'", error=MissingExtra)


def test_importing_the_readers_imports_no_heavy_library() -> None:
    heavy = ["rosbags", "mcap", "laspy", "pyproj", "pyarrow", "pandas"]
    code = f"import sys, terrafuse.logs, terrafuse.logs.recorder; print([m for m in {heavy} if m in sys.modules])"
    path = str(Path(__file__).parents[2] / "src")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env={"PYTHONPATH": path})
    assert done.stdout.strip() == "[]", done.stderr


def test_a_folder_of_clouds_and_a_trajectory_opens_by_itself(tmp_path: Path) -> None:
    (tmp_path / "1.5.xyz").write_text("1 2 3\n")
    write_tum(tmp_path / "trajectory.txt", [("1.5", (0, 0, 0))])
    assert open_log(str(tmp_path)).reader == "clouds"
