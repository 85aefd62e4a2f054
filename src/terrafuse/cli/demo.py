"""The first thing that people run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from terrafuse import config, mapping, results
from terrafuse.cli.output import LogProgress
from terrafuse.demo.logs import write_logs
from terrafuse.demo.truth import compare
from terrafuse.export.files import final
from terrafuse.folders import folder_for
from terrafuse.replica import Replica
from terrafuse.store.sqlite import SqliteStore


def run_demo(out: Path, progress: LogProgress) -> dict[str, Any]:
    """Write the robots' logs, map them as anybody's logs are mapped, and compare with the truth; returns the report."""
    with folder_for(out):
        progress.stage("drive")
        logs = write_logs(out / "logs")
    plan = mapping.plan({name: str(path) for name, path in logs.items()}, config.map_settings(resolution_m=0.1))
    report = results.run(plan, out, overwrite=True, progress=progress, stage=progress.stage)
    with SqliteStore.open(out / results.STORE) as store:
        report["truth"] = compare(Replica(store=store))
    with final(out / results.FILES["report_json"]) as temporary:
        temporary.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n")
    return report
