"""ROS 1 bags, ROS 2 bag folders, bare .mcap and .db3 files behind one face: rosbags, which needs no ROS."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from terrafuse.errors import LogError, TerrafuseError
from terrafuse.logs.libraries import library
from terrafuse.logs.options import listed

FILE_SUFFIXES = (".bag", ".mcap", ".db3")
REMEDIES = {
    ".bag": "repair it with `rosbag reindex`",
    ".mcap": "repair it with `mcap recover`",
    ".db3": "repair it with sqlite3's `.recover`",
}
FOLDER_REMEDY = "repair it with `ros2 bag reindex`"


@dataclass(frozen=True)
class Topic:
    """A topic that has messages. `connections` are its publishers, as rosbags counts them."""

    name: str
    type: str
    count: int
    connections: list[Any]

    def __str__(self) -> str:
        return f"{self.name} ({self.type})"


def is_bag(path: Path) -> bool:
    if path.is_file():
        return path.suffix in FILE_SUFFIXES
    return (path / "metadata.yaml").is_file() or bool(_storage_files(path))


def bag_file(path: Path) -> Path:
    """What to open: of a folder without metadata.yaml (its recorder crashed) the one storage file."""
    if path.is_file() or (path / "metadata.yaml").is_file():
        return path
    files = _storage_files(path)
    if len(files) != 1:
        names = listed(file.name for file in files)
        raise LogError(f"{path}: no metadata.yaml and {len(files)} files ({names}); give one, or {FOLDER_REMEDY}")
    return files[0]


def _storage_files(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix in (".mcap", ".db3"))


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """rosbags' AnyReader, open. Raises LogError with the tool that repairs such a file."""
    highlevel = library("rosbags.highlevel", "ROS", "ros")
    typesys = library("rosbags.typesys", "ROS", "ros")
    # bags before ROS 2 Iron hold no message definitions; the messages read here have not changed since
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    try:
        reader = highlevel.AnyReader([path], default_typestore=store)
        reader.open()
    except TerrafuseError:
        raise
    except Exception as error:  # rosbags also lets struct.error, AssertionError and others through
        remedy = REMEDIES.get(path.suffix, FOLDER_REMEDY)
        raise LogError(f"{path}: can't be opened as a ROS bag ({error}); if it was cut short, {remedy}") from error
    try:
        yield reader
    finally:
        reader.close()


def topics_of(bag: Any) -> dict[str, Topic]:
    grouped: dict[str, list[Any]] = {}
    for connection in bag.connections:
        if connection.msgcount:
            grouped.setdefault(connection.topic, []).append(connection)
    return {
        name: Topic(name, found[0].msgtype, sum(connection.msgcount for connection in found), found)
        for name, found in sorted(grouped.items())
    }


def messages(bag: Any, topic: Topic, path: Path) -> Iterator[tuple[int, Any]]:
    """Number (from 1) and message, in the order of recording, one in memory at a time. Raises LogError."""
    number = 0
    try:
        for connection, _, raw in bag.messages(topic.connections):
            number += 1
            yield number, bag.deserialize(raw, connection.msgtype)
    except TerrafuseError:
        raise
    except Exception as error:
        where = f"{path}: {topic.name}: message {number or 1}"
        remedy = REMEDIES.get(path.suffix, FOLDER_REMEDY)
        raise LogError(f"{where}: truncated or damaged ({type(error).__name__}: {error}); {remedy}") from error


def stamp_of(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def frame_of(name: str) -> str:
    """tf2 took the leading slash out of frame names; ROS 1 bags still have it."""
    return name.lstrip("/")
