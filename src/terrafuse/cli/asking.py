"""What a fleet tells of itself, for a command: as JSON, as a table, live."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from terrafuse.cli.output import note

if TYPE_CHECKING:
    from terrafuse.services.directory import Entry

FILE_COLUMNS = 160
"""Of the table, where no terminal says how many there are."""
SHOWN = (
    "scans",
    "revision",
    "corrections",
    "rebuilding",
    "tiles",
    "peers",
    "behind",
    "channels",
    "trouble",
    "said",
    "nodes",
)
"""Of states, in the table; `terrafuse get` has all."""


def operator_at(connect: Sequence[str], station_name: str, name: str | None, keys: Path | None, insecure: bool) -> Any:
    from terrafuse.exchange.links.transport import Transport
    from terrafuse.exchange.links.zenoh import ZenohLink
    from terrafuse.services.operator import operator, operator_name

    own = name or (keys.resolve().name if keys is not None else operator_name())
    return operator(ZenohLink(own, Transport(connect=connect, keys=keys, insecure=insecure), note), station_name)


def status_json(status: Any) -> dict[str, Any]:
    import msgspec

    out: dict[str, Any] = _finite(msgspec.to_builtins(status))
    return out


def _finite(value: Any) -> Any:
    """What a node says of itself may be anything; JSON has no NaN."""
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_finite(inner) for inner in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def entry_json(entry: Entry) -> dict[str, Any]:
    services = [status_json(status) for status in entry.services]
    left = entry.lost and _gone(entry) == "left"
    return {
        "node": entry.node, "age_s": round(entry.age_s, 1), "lost": entry.lost and not left, "left": left,
        "services": services,
    }  # fmt: skip


def watch(asking: Any) -> None:
    from rich.live import Live

    try:
        with Live(screen=False, auto_refresh=False) as live:
            for entries in asking.watch():
                live.update(_table(entries), refresh=True)
    except KeyboardInterrupt:
        pass  # that is how it ends


def print_table(entries: Sequence[Entry]) -> None:
    from rich.console import Console

    console = Console()
    console.print(_table(entries), width=console.width if console.is_terminal else FILE_COLUMNS)


def _table(entries: Sequence[Entry]) -> Any:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in ("service", "health", "state"):
        table.add_column(column, no_wrap=column != "state")
    for entry in entries:
        for status in entry.services:
            health = f"{_gone(entry)} {entry.age_s:.0f} s ago" if entry.lost else status.health
            again = f"started again {_times(status.restarts)}" if status.restarts else ""
            words = [word for word in (again, status.reason, _short(status.state)) if word]
            row = (f"{entry.node}/{status.name}", health, "; ".join(words))
            table.add_row(*(Text("".join(c if c.isprintable() else "?" for c in text)) for text in row))
    return table


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _gone(entry: Entry) -> str:
    """A robot that ends when all is at the station has left."""
    return "left" if any(status.state.get("level") for status in entry.services) else "lost"


def _short(state: dict[str, Any]) -> str:
    return ", ".join(f"{key} {_plain(state[key])}" for key in SHOWN if state.get(key) not in (None, {}, [], ""))


def _plain(value: Any) -> str:
    if isinstance(value, dict):
        return " ".join(f"{key} {_plain(inner)}" for key, inner in value.items()) or "none"
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)
