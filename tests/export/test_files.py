"""Whatever goes wrong, a file stands whole or not at all."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from terrafuse.errors import InputError, OutputError
from terrafuse.export import EXPORTERS, export_map
from terrafuse.export.files import final
from terrafuse.replica import Replica

FORMATS = [(name, exporter.suffixes[0]) for name, exporter in EXPORTERS.items()]
ONE_FILE = [(name, suffix) for name, suffix in FORMATS if name != "ros-map"]  # that one has an image beside it


def raise_error(number: int):
    def fail(*_args, **_kwargs):
        raise OSError(number, os.strerror(number))

    return fail


def test_the_file_appears_at_the_end(tmp_path: Path) -> None:
    target = tmp_path / "map.tif"
    with final(target) as temporary:
        temporary.write_text("new")
        assert temporary.parent == tmp_path
        assert temporary.name.startswith(".map.")
        assert temporary.name.endswith(".partial.tif")
        assert not target.exists()
    assert target.read_text() == "new"
    assert os.listdir(tmp_path) == ["map.tif"]


def test_two_writers_of_one_name_do_not_meet(tmp_path: Path) -> None:
    with final(tmp_path / "map") as first, final(tmp_path / "map") as second:
        first.write_text("1")
        second.write_text("2")
    assert (tmp_path / "map").read_text() == "1"
    assert os.listdir(tmp_path) == ["map"]


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "full"), ValueError("a bug"), KeyboardInterrupt()])
def test_an_error_leaves_what_was_there(tmp_path: Path, error: BaseException) -> None:
    target = tmp_path / "a [1]*.tif"
    target.write_text("old")
    expected = OutputError if isinstance(error, OSError) else type(error)

    def write() -> None:
        with final(target) as temporary:
            temporary.write_text("half")
            temporary.with_suffix(".ovr.tmp").write_text("a library's own scratch")
            raise error

    with pytest.raises(expected):
        write()
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == [target.name]


def test_no_space_is_named_with_the_remedy(tmp_path: Path) -> None:
    with (
        pytest.raises(OutputError, match=r"map\.tif.*no space left in .*free some") as caught,
        final(tmp_path / "map.tif"),
    ):
        raise_error(errno.ENOSPC)()
    assert caught.value.exit_code == 2


def test_a_failing_sync_is_no_success(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "map").write_text("old")
    monkeypatch.setattr(os, "fsync", raise_error(errno.EIO))
    with pytest.raises(OutputError), final(tmp_path / "map") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "map").read_text() == "old"
    assert os.listdir(tmp_path) == ["map"]


def test_a_missing_folder_is_told_before_the_work(tmp_path: Path) -> None:
    worked = False
    with pytest.raises(OutputError, match=r"there is no folder .*create it"), final(tmp_path / "no" / "map.tif"):
        worked = True
    assert not worked


def test_a_folder_without_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By injection: who runs this as root may write anywhere."""
    monkeypatch.setattr(Path, "touch", raise_error(errno.EACCES))
    with pytest.raises(OutputError, match="no permission in"), final(tmp_path / "map.tif"):
        pass


def test_devices_and_folders_are_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "folder.tif").mkdir()
    for target in (Path(os.devnull), tmp_path / "folder.tif"):
        with pytest.raises(OutputError, match="not a regular file"), final(target):
            pass
    assert not Path(os.devnull).is_file()


@pytest.mark.parametrize(("name", "suffix"), ONE_FILE)
def test_every_format_writes_safely(
    name: str, suffix: str, local_map: Replica, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk fills up when all the rest is done: the old file stays, and nothing else lies about."""
    target = tmp_path / f"map{suffix}"
    target.write_text("old")
    with monkeypatch.context() as broken:
        broken.setattr(os, "fsync", raise_error(errno.ENOSPC))
        with pytest.raises(OutputError, match="no space left"):
            export_map(local_map, target, layers=["height"])
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == [target.name]
    assert export_map(local_map, target, layers=["height"]) == name
    assert target.stat().st_size > 1000
    assert os.listdir(tmp_path) == [target.name]


def test_no_space_in_the_middle_of_an_array(
    local_map: Replica, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(np.lib.format, "write_array", raise_error(errno.ENOSPC))
    with pytest.raises(OutputError, match="no space left"):
        export_map(local_map, tmp_path / "map.npz")
    assert os.listdir(tmp_path) == []


def test_the_ending_says_the_format(local_map: Replica, tmp_path: Path) -> None:
    assert export_map(local_map, tmp_path / "MAP.TIFF", layers=["n"]) == "cog"
    assert export_map(local_map, tmp_path / "without", format="npz", layers=["n"]) == "npz"
    with pytest.raises(InputError, match=r"'\.bmp'.*cog \(\.tif, \.tiff\), png"):
        export_map(local_map, tmp_path / "map.bmp")
    with pytest.raises(InputError, match=r"no format 'bmp'.*npz"):
        export_map(local_map, tmp_path / "map.tif", format="bmp")


@pytest.mark.parametrize(("name", "suffix"), FORMATS)
def test_an_empty_map_or_a_wrong_layer_leaves_no_file(
    name: str, suffix: str, local_map: Replica, empty_map: Replica, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="empty"):
        export_map(empty_map, tmp_path / f"map{suffix}")
    with pytest.raises(InputError, match=r"no layer 'colour'.*height"):
        export_map(local_map, tmp_path / f"map{suffix}", layers=["colour"])
    assert os.listdir(tmp_path) == []
