"""What every log reader must do."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from terrafuse.errors import LogError
from terrafuse.logs import READERS, Log, Reader, Record, Source, open_log
from terrafuse.types import Scan, is_rigid


class ReaderTests:
    """Subclass, and define the fixtures `reader` and `sample`: the path of a small log with at least one scan."""

    options: Mapping[str, str] = {}
    """What must follow the `?` for the sample to be read."""
    aimed: bool = False
    """Whether the sample says nothing of where beams look, so that only a description makes points of its readings."""

    @pytest.fixture
    def reader(self) -> Reader:
        raise NotImplementedError

    @pytest.fixture
    def sample(self, tmp_path: Path) -> Path:
        raise NotImplementedError

    @pytest.fixture
    def log(self, reader: Reader, sample: Path) -> Log:
        return self._open(reader, sample)

    def test_stands_in_the_dict_under_its_name(self, reader: Reader) -> None:
        assert READERS[reader.name] is reader
        assert reader.summary
        assert all(reader.options.values()), "each option has a line of help"

    def test_knows_its_own_logs_from_others(self, reader: Reader, sample: Path, tmp_path: Path) -> None:
        assert reader.matches(sample)
        (tmp_path / "notes.md").write_text("no log at all\n")
        (tmp_path / "empty").mkdir()
        assert not reader.matches(tmp_path / "notes.md")
        assert not reader.matches(tmp_path / "empty")

    def test_scans_are_whole_and_in_stamp_order(self, log: Log, reader: Reader) -> None:
        records = list(log.scans())
        assert log.reader == reader.name
        assert log.count in (None, len(records))
        stamps = [record.stamp_ns for record in records]
        assert stamps == sorted(stamps)
        scans = [record for record in records if isinstance(record, Scan)]
        assert scans, "the sample holds no scan"
        for scan in scans:
            assert isinstance(scan.stamp_ns, int)
            assert (scan.points.ndim, scan.points.shape[1]) == (2, 3)
            assert scan.points.dtype in (np.float32, np.float64)
            assert is_rigid(scan.T_world_sensor.matrix)

    def test_each_pass_is_a_fresh_one(self, log: Log) -> None:
        first, second = log.scans(), log.scans()
        next(first)
        assert _content(second) == _content(log.scans())

    def test_an_option_that_there_is_not_is_refused(self, reader: Reader, sample: Path) -> None:
        with pytest.raises(LogError, match="no_such_option"):
            self._open(reader, sample, no_such_option="1")

    @pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
    def test_a_log_that_was_cut_short_gives_whole_scans_or_an_error(
        self, reader: Reader, sample: Path, tmp_path: Path, share: float
    ) -> None:
        """Never another exception than LogError; and every scan as it was, but for the last, where the cut may be."""
        if not sample.is_file():
            pytest.skip("the sample is a folder")
        cut = tmp_path / "cut" / sample.name
        cut.parent.mkdir()
        shutil.copy(sample, cut)
        with cut.open("r+b") as file:
            file.truncate(int(sample.stat().st_size * share))
        whole = _content(self._open(reader, sample).scans())
        read: list[Record] = []
        with suppress(LogError):
            read.extend(self._open(reader, cut).scans())
        assert set(_content(iter(read[:-1]))) <= set(whole)

    def _open(self, reader: Reader, path: Path, **options: str) -> Log:
        return open_log(Source(path, {"reader": reader.name, **self.options, **options}, self.aimed))


def _content(records: Iterator[Record]) -> list[tuple[object, ...]]:
    return [
        (r.stamp_ns, r.points.tobytes(), _ranges(r), r.T_world_sensor.matrix.tobytes())
        if isinstance(r, Scan)
        else (r.stamp_ns, r.reason)
        for r in records
    ]


def _ranges(scan: Scan) -> bytes:
    return b"" if scan.readings is None else scan.readings.ranges_m.tobytes()
