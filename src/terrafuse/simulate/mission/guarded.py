"""A study in a net: one that fails costs its own tables and pictures, never what else came of a run."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from terrafuse.simulate.mission.engine import Mission, Watcher
from terrafuse.simulate.mission.studies import Study
from terrafuse.simulate.mission.tables import Table

Made = TypeVar("Made")


class Guarded:
    """A study that is asked nothing more once it failed; `failure` says why."""

    def __init__(self, study: Study) -> None:
        self.failure: str | None = None
        self._study = study
        self.watchers: Sequence[Watcher] = [self._watched(watch) for watch in study.watchers]

    def tables(self) -> list[dict[str, Any]]:
        """As JSON."""
        return self._kept(lambda: _plain(self._study.tables()), [])

    def timed_tables(self) -> list[dict[str, Any]]:
        return self._kept(lambda: _plain(self._study.timed_tables()), [])

    def pictures(self, out: Path) -> dict[str, str]:
        return self._kept(lambda: self._study.pictures(out), {})

    def excuses(self) -> list[dict[str, Any]]:
        """To ask at the end: a table that says that it failed, if it did."""
        if self.failure is None:
            return []
        rows = (("study", self.failure),)
        return [Table("The study failed", ("what", "why"), rows, "All else of this run is there.").as_json()]

    def _watched(self, watch: Watcher) -> Watcher:
        def guarded(mission: Mission) -> None:
            self._kept(lambda: watch(mission), None)

        return guarded

    def _kept(self, work: Callable[[], Made], instead: Made) -> Made:
        if self.failure is not None:
            return instead
        try:
            return work()
        except Exception as error:  # whatever it is
            self.failure = f"{type(error).__name__}: {error}"
            return instead


def _plain(tables: Sequence[Table]) -> list[dict[str, Any]]:
    """Raises ValueError for numbers that JSON has not."""
    out = [table.as_json() for table in tables]
    json.dumps(out, allow_nan=False)
    return out
