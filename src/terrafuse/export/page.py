"""HTML pages that need nothing else: no scripts, no links, pictures inside; and their tables."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from terrafuse.errors import InputError
from terrafuse.export.files import final

STYLE = """
:root { color-scheme: light dark; --ink: #22272e; --quiet: #68717d; --line: #dfe3e8; --page: #ffffff; --soft: #f6f7f9;
  --accent: #2f6650; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e8ed; --quiet: #98a2ae; --line: #343b44; --page: #15191e;
  --soft: #1d2229; --accent: #86c5a5; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 76rem; padding: 2rem 1.25rem 4rem; background: var(--page); color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; margin: 0; }
h2 { font-size: 1.1rem; margin: 2.2rem 0 .6rem; color: var(--accent); }
.quiet { color: var(--quiet); margin: .2rem 0 1.2rem; }
.facts { display: grid; grid-template-columns: repeat(auto-fit, minmax(8.5rem, 1fr)); gap: .75rem; margin: 1.2rem 0; }
.facts div { background: var(--soft); border: 1px solid var(--line); border-radius: .5rem; padding: .6rem .8rem; }
.facts b { display: block; font-size: 1.3rem; font-weight: 600; font-variant-numeric: tabular-nums; }
.facts span { color: var(--quiet); font-size: .8rem; }
img { display: block; max-width: 100%; height: auto; margin: auto; }
figcaption { color: #68717d; font-size: .85rem; text-align: center; padding: .4rem; }
figure { margin: 0 0 1rem; background: #ffffff; border: 1px solid var(--line); border-radius: .5rem; padding: .5rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .88rem; }
th, td { padding: .35rem .7rem; border-bottom: 1px solid var(--line); text-align: left; vertical-align: top; }
thead th { color: var(--quiet); font-weight: 500; white-space: nowrap; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td { min-width: 7rem; overflow-wrap: anywhere; }
td.number { min-width: 0; }
th[scope=row] { font-weight: 600; white-space: nowrap; }
code { font: .85em ui-monospace, "DejaVu Sans Mono", monospace; }
"""

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8"/>
<meta name="viewport" content="width=device-width, initial-scale=1"/>
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<h1>{title}</h1>
<p class="quiet">{about}</p>
{body}
</body>
</html>
"""

Row = Sequence["str | Number"]


@dataclass(frozen=True)
class Number:
    """A cell that is set to the right."""

    text: str


def write_page(path: Path | str, title: str, about: str, body: Iterable[str]) -> None:
    """Write a page of these parts, which are HTML; `title` and `about` are text. Raises OutputError."""
    text = PAGE.format(title=escape(title), style=STYLE, about=escape(about), body="\n".join(body))
    with final(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def figure(path: Path | str, alt: str, caption: str = "") -> str:
    """A PNG, APNG or GIF within the page. Raises InputError where it can't be read."""
    try:
        image = base64.b64encode(Path(path).read_bytes()).decode("ascii")
    except OSError as error:
        raise InputError(f"{path}: the report's picture can't be read: {error.strerror}") from error
    kind = "gif" if Path(path).suffix == ".gif" else "png"
    words = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f'<figure><img alt="{escape(alt)}" src="data:image/{kind};base64,{image}"/>{words}</figure>'


def boxes(facts: Mapping[str, str]) -> str:
    """The few numbers that are looked at first, by what they are; empty ones are left out."""
    each = (f"<div><b>{escape(value)}</b><span>{escape(name)}</span></div>" for name, value in facts.items() if value)
    return f'<div class="facts">{"".join(each)}</div>'


def section(title: str, content: str) -> str:
    """Empty without content; that is HTML, the title text."""
    return f"<section><h2>{escape(title)}</h2>{content}</section>" if content else ""


def table(head: Iterable[str], rows: Sequence[Row]) -> str:
    """Empty without rows. The first cell of a row names it; everything is escaped here."""
    if not rows:
        return ""
    kinds = [' class="number"' if isinstance(cell, Number) else "" for cell in rows[0]]
    titles = "".join(f"<th{kind}>{escape(name)}</th>" for name, kind in zip(head, kinds, strict=False))
    lines = "".join(f"<tr>{_cells(row)}</tr>" for row in rows)
    header = f"<thead><tr>{titles}</tr></thead>" if titles else ""
    return f'<div class="wide"><table>{header}<tbody>{lines}</tbody></table></div>'


def _cells(row: Row) -> str:
    first, *others = row
    return _cell("th", ' scope="row"', first) + "".join(_cell("td", "", cell) for cell in others)


def _cell(tag: str, attributes: str, cell: str | Number) -> str:
    if isinstance(cell, Number):
        return f'<{tag}{attributes} class="number">{escape(cell.text)}</{tag}>'
    return f"<{tag}{attributes}>{escape(cell)}</{tag}>"
