"""What every pass over every log obeys: stamps run forwards; damage is an error naming file and record."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from terrafuse.errors import LogError, TerrafuseError
from terrafuse.logs.base import Log, Record
from terrafuse.logs.stamps import in_seconds
from terrafuse.types import Skipped, Stamp

BACKWARDS = ("error", "drop")


@contextmanager
def damage_as_log_error(where: Callable[[], str]) -> Iterator[None]:
    """Whatever a library raises on a truncated or corrupt file is a LogError that starts with `where()`.

    Caught this wide because the libraries document no hierarchy: damaged bags raise AssertionError,
    struct.error, zlib.error, KeyError and others. The cause stays chained.
    """
    try:
        yield
    except TerrafuseError:
        raise
    except Exception as error:  # MemoryError too: a damaged length asks for terabytes
        text = str(error) or "no details"
        raise LogError(f"{where()}: truncated or damaged ({type(error).__name__}: {text})") from error


def guarded(log: Log, backwards: str, remedy: str) -> Callable[[], Iterator[Record]]:
    """`log.scans` with both promises; `backwards` is `error` or `drop`."""
    return lambda: forwards(readable(log), log, backwards, remedy)


def readable(log: Log) -> Iterator[Record]:
    number = 0
    with damage_as_log_error(lambda: f"{log.path}: record {number + 1}"):
        for record in log.scans():
            number += 1
            yield record


def forwards(records: Iterator[Record], log: Log, backwards: str, remedy: str) -> Iterator[Record]:
    last: Stamp | None = None
    for number, record in enumerate(records, 1):
        if last is not None and record.stamp_ns < last:
            if backwards == "error":
                raise LogError(
                    f"{log.path}: record {number}: its stamp {in_seconds(record.stamp_ns)} s runs backwards, "
                    f"the one before has {in_seconds(last)} s; {remedy}"
                )
            yield Skipped(record.stamp_ns, "stamp runs backwards")
            continue
        last = record.stamp_ns
        yield record
