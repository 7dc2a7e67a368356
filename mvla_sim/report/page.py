"""The report: one self-contained HTML page from stored results alone, readable on a phone and on paper."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from mvla_sim.files import atomic_output

__all__ = ["Section", "table_html", "write_page"]

_STYLE = """
:root { --ink: #1b1b1b; --soft: #5a5a5a; --line: #d8d8d8; --good: #00664a; --bad: #9c3a00; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 62rem; padding: 1rem; color: var(--ink); background: #fff;
       font: 16px/1.5 system-ui, sans-serif; overflow-wrap: anywhere; }
h1 { font-size: 1.6rem; line-height: 1.2; }
h2 { font-size: 1.2rem; margin-top: 2.2rem; border-top: 1px solid var(--line); padding-top: 1rem; }
p.lead, figcaption, .note { color: var(--soft); }
figure { margin: 1rem 0; } img { max-width: 100%; height: auto; display: block; }
figcaption { font-size: .9rem; margin-top: .3rem; }
.scroll { overflow-x: auto; max-width: 100%; }
table { border-collapse: collapse; font-size: .88rem; } caption { text-align: left; color: var(--soft); }
th, td { border-bottom: 1px solid var(--line); padding: .3rem .6rem; text-align: left; vertical-align: top;
         overflow-wrap: normal; }
td.number { text-align: right; font-variant-numeric: tabular-nums; }
.badge { font-weight: 600; white-space: nowrap; } .holds { color: var(--good); } .fails { color: var(--bad); }
.untested { color: var(--soft); }
pre { white-space: pre-wrap; font-size: .8rem; } details { margin: .5rem 0; }
@media print { body { font-size: 10pt; max-width: none; } details { display: none; }
               figure, tr { break-inside: avoid; } }
"""
_BADGES = {"holds": ("holds", "✓ holds"), "does not hold": ("fails", "✗ does not hold"),
           "not tested": ("untested", "– not tested")}  # fmt: skip


@dataclass(frozen=True)
class Section:
    """One part of the page.

    Attributes
    ----------
    title
        Heading.
    text
        A paragraph, plain text.
    figures
        PNG files with their captions.
    tables
        Tables as HTML, from :func:`table_html`.
    folded
        Long plain texts behind a click, by title.
    """

    title: str
    text: str = ""
    figures: Sequence[tuple[Path, str]] = ()
    tables: Sequence[str] = ()
    folded: Mapping[str, str] = field(default_factory=dict)


def table_html(table: pd.DataFrame, caption: str = "", digits: int = 4) -> str:
    """Turn a table into HTML that scrolls in a box of its own; verdicts become badges, everything is escaped."""
    heads = "".join(f"<th>{html.escape(str(name))}</th>" for name in table.columns)
    rows = "".join(
        f"<tr>{''.join(_cell(value, digits) for value in row)}</tr>" for row in table.itertuples(index=False)
    )
    title = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    return f'<div class="scroll"><table>{title}<thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>'


def write_page(path: Path, title: str, lead: str, sections: Sequence[Section]) -> Path:
    """Write the page; pictures are part of it, and it needs no script and no other file.

    Raises
    ------
    OutputError
        The page cannot be written.
    """
    body = "\n".join(_section(section) for section in sections)
    page = (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head><body>"
        f'<h1>{html.escape(title)}</h1><p class="lead">{html.escape(lead)}</p>\n{body}\n</body></html>\n'
    )
    with atomic_output(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def _section(section: Section) -> str:
    parts = [f"<h2>{html.escape(section.title)}</h2>"]
    if section.text:
        parts.append(f"<p>{html.escape(section.text)}</p>")
    for file, caption in section.figures:
        data = base64.b64encode(file.read_bytes()).decode("ascii")
        parts.append(
            f'<figure><img src="data:image/png;base64,{data}" alt="{html.escape(caption, quote=True)}">'
            f"<figcaption>{html.escape(caption)}</figcaption></figure>"
        )
    parts += section.tables
    for title, text in section.folded.items():
        parts.append(f"<details><summary>{html.escape(title)}</summary><pre>{html.escape(text)}</pre></details>")
    return "\n".join(parts)


def _cell(value: Any, digits: int) -> str:
    if isinstance(value, str) and value in _BADGES:
        kind, text = _BADGES[value]
        return f'<td><span class="badge {kind}">{text}</span></td>'
    if isinstance(value, float):
        return f'<td class="number">{value:.{digits}g}</td>' if value == value else '<td class="number">–</td>'  # noqa: PLR0124
    return f"<td>{html.escape(str(value))}</td>"


def pretty(data: Mapping[str, Any]) -> str:
    """Plain data as indented JSON, for a folded text."""
    return json.dumps(data, indent=1, sort_keys=True, ensure_ascii=False)
