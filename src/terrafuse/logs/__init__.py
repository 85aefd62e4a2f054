"""Recordings → scans with poses. `open_log("PATH?key=value")` is the way in, `READERS` the known formats."""

from __future__ import annotations

from dataclasses import replace

from terrafuse.errors import LogError
from terrafuse.logs import av2, carmen, clouds, kitti, las, ranges, ros
from terrafuse.logs.base import Log, Reader, Record, Source, parse_source
from terrafuse.logs.guard import BACKWARDS, damage_as_log_error, guarded
from terrafuse.logs.options import choice, listed

__all__ = ["COMMON_OPTIONS", "READERS", "Log", "Reader", "Record", "Source", "open_log", "parse_source"]

READERS: dict[str, Reader] = {
    reader.name: reader
    for reader in (ros.READER, av2.READER, kitti.READER, carmen.READER, las.READER, ranges.READER, clouds.READER)
}
"""In the order in which they are asked: `clouds` takes nearly any folder, so it comes last."""

COMMON_OPTIONS = {
    "reader": f"read as this format, one of {listed(READERS)} (default: by names and first bytes)",
    "backwards": "error (default) | drop: count scans whose stamp runs backwards as skipped",
}
"""Options of every reader, each with a line of help."""


def open_log(given: str | Source) -> Log:
    """Opens `PATH?key=value&key=value`, or a Source.

    Raises LogError where the path is missing, the format unknown, an option not the reader's, or the
    recording can't be used; the message has the remedy. `scans()` of the result raises LogError for damage
    met on the way and for stamps that run backwards.
    """
    source = parse_source(given) if isinstance(given, str) else given
    if not source.path.exists():
        raise LogError(f"{source.path}: no such file or folder")
    reader = _reader_of(source)
    _check_keys(source, reader)
    backwards = choice(source, "backwards", BACKWARDS, "error")
    with damage_as_log_error(lambda: f"{source.path}: can't be opened as {reader.name}"):
        log = reader.open(source)
    return replace(log, scans=guarded(log, backwards, _backwards_remedy(reader)))


def _reader_of(source: Source) -> Reader:
    if "reader" in source.options:
        return READERS[choice(source, "reader", READERS, "")]
    for reader in READERS.values():
        with damage_as_log_error(lambda: f"{source.path}: can't be looked at"):
            if reader.matches(source.path):
                return reader
    known = "\n".join(f"  {reader.name}: {reader.summary}" for reader in READERS.values())
    raise LogError(f"{source.path}: not a recording of a known format. Known, to force one with ?reader=NAME:\n{known}")


def _check_keys(source: Source, reader: Reader) -> None:
    known = {**reader.options, **COMMON_OPTIONS}
    for key in source.options:
        if key not in known:
            raise LogError(f"{source.path}: reader {reader.name} has no option '{key}'; it has {listed(known)}")


def _backwards_remedy(reader: Reader) -> str:
    remedy = "say ?backwards=drop to skip such scans"
    return f"{remedy}, or ?stamps=index&rate_hz=5 to number them" if "stamps" in reader.options else remedy
