"""The report: one self-contained HTML page from stored results alone, readable on a phone and on paper."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
from PIL import Image

from mvla_sim.files import atomic_output

__all__ = ["Section", "table_html", "write_page"]

_STYLE = """
:root { --ink: #1b1b1b; --soft: #5a5a5a; --line: #d8d8d8; --pale: #f5f6f7; --good: #00664a; --bad: #9c3a00; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 66rem; padding: 1rem; color: var(--ink); background: #fff;
       font: 16px/1.5 system-ui, "DejaVu Sans", sans-serif; overflow-wrap: anywhere; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: .5rem 0; }
h2 { font-size: 1.25rem; line-height: 1.3; margin-top: 2.4rem; border-top: 1px solid var(--line); padding-top: 1rem; }
p.lead, figcaption { color: var(--soft); }
p.warn { border-left: .25rem solid var(--bad); padding: .3rem .8rem; background: #fdf4ee; }
ul.keys { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 13rem), 1fr)); gap: .8rem;
          list-style: none; margin: 1rem 0; padding: 0; }
ul.keys li { background: var(--pale); border-radius: .5rem; padding: .7rem .9rem; }
ul.keys b { display: block; font-size: 1.35rem; line-height: 1.3; font-variant-numeric: tabular-nums; }
figure { margin: 1.2rem 0; } img { max-width: 100%; height: auto; display: block; }
figure.many > div { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 24rem), 1fr)); gap: .6rem; }
figure.one > div { overflow-x: auto; } figcaption { font-size: .9rem; margin-top: .4rem; }
.scroll { overflow-x: auto; max-width: 100%; }
table { border-collapse: collapse; font-size: .88rem; } caption { text-align: left; color: var(--soft); }
th, td { border-bottom: 1px solid var(--line); padding: .35rem .6rem; text-align: left; vertical-align: top;
         overflow-wrap: normal; }
td.number { text-align: right; font-variant-numeric: tabular-nums; }
.badge { font-weight: 600; white-space: nowrap; border-radius: 1rem; padding: .05rem .6rem; }
.holds { color: var(--good); background: #e2f3ec; } .fails { color: var(--bad); background: #fbe9dd; }
.untested { color: var(--soft); background: #eeeeee; }
summary { cursor: pointer; } pre { white-space: pre-wrap; font-size: .8rem; } details { margin: .5rem 0; }
@media screen and (max-width: 46rem) {
  figure.one img { max-width: none; width: 44rem; }
  table.stack, .stack tbody, .stack tr, .stack td { display: block; width: 100%; }
  .stack thead { position: absolute; clip-path: inset(50%); width: 1px; height: 1px; overflow: hidden; }
  .stack tr { background: var(--pale); border-radius: .5rem; margin: .6rem 0; padding: .5rem .7rem; }
  .stack td { border: 0; padding: .12rem 0; } .stack td.number { text-align: left; } .stack td:empty { display: none; }
  .stack td::before { content: attr(data-label) ": "; color: var(--soft); }
}
@media print {
  body { font-size: 10pt; max-width: none; padding: 0; } h2 { break-after: avoid; }
  details::details-content { content-visibility: visible; block-size: auto; } pre { font-size: 7pt; line-height: 1.25; }
  .scroll, figure.one > div { overflow: visible; } table { font-size: 8pt; } th, td { overflow-wrap: anywhere; }
  figure.many > div { grid-template-columns: 1fr 1fr; } img, tr, li { break-inside: avoid; }
  .badge, ul.keys li, p.warn { print-color-adjust: exact; }
}
"""
_BADGES = {"holds": ("holds", "✓ holds"), "does not hold": ("fails", "✗ does not hold"),
           "not tested": ("untested", "– not tested")}  # fmt: skip


Figures = Sequence[tuple["Path | Sequence[tuple[bytes, str]]", str]]


@dataclass(frozen=True, eq=False)
class Section:
    """One part of the page."""

    title: str
    text: str = ""  # a paragraph, plain text
    # Each a PNG file, or PNGs with alt texts that stand beside each other where there is room, and its caption.
    figures: Figures = ()
    tables: Sequence[str] = ()  # tables as HTML, from `table_html`
    folded: Mapping[str, str] = field(default_factory=dict)  # long texts behind a click, by title; printed in full
    warning: str = ""  # a paragraph that must not be overlooked
    keys: Sequence[tuple[str, str]] = ()  # figures that say most, each with what it is

    def __repr__(self) -> str:
        """One line: its heading."""
        return f"Section({self.title!r})"


def table_html(table: pd.DataFrame, caption: str = "", digits: int = 4, *, stack: bool = False) -> str:
    """Turn a table into HTML that scrolls in a box of its own; verdicts become badges, everything is escaped.

    ``stack``: on a phone each row is a card with its cells beneath each other, for tables of sentences.
    """
    heads = "".join(f'<th scope="col">{html.escape(str(name))}</th>' for name in table.columns)
    rows = "".join(
        f"<tr>{''.join(_cell(v, digits, n) for v, n in zip(row, table.columns, strict=True))}</tr>"
        for row in table.itertuples(index=False)
    )
    kind = ' class="stack"' if stack else ""
    title = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    return f'<div class="scroll"><table{kind}>{title}<thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>'


def write_page(path: Path, title: str, lead: str, sections: Sequence[Section]) -> Path:
    """Write the page; pictures are part of it, and it needs no script and no other file.

    Raises OutputError: the page cannot be written.
    """
    body = "\n".join(_section(section) for section in sections)
    page = (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head><body><main>"
        f'<h1>{html.escape(title)}</h1><p class="lead">{html.escape(lead)}</p>\n{body}\n</main></body></html>\n'
    )
    with atomic_output(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def _section(section: Section) -> str:
    parts = [f"<h2>{html.escape(section.title)}</h2>"]
    if section.text:
        parts.append(f"<p>{html.escape(section.text)}</p>")
    if section.warning:
        parts.append(f'<p class="warn">{html.escape(section.warning)}</p>')
    if section.keys:
        items = "".join(f"<li><b>{html.escape(figure)}</b>{html.escape(what)}</li>" for figure, what in section.keys)
        parts.append(f'<ul class="keys">{items}</ul>')
    for shown, caption in section.figures:
        pictures = [(shown.read_bytes(), caption)] if isinstance(shown, Path) else shown
        images = "".join(
            f'<img src="data:image/png;base64,{_embedded(data)}" alt="{html.escape(alt)}">' for data, alt in pictures
        )
        kind = "one" if isinstance(shown, Path) else "many"
        parts.append(
            f'<figure class="{kind}"><div>{images}</div><figcaption>{html.escape(caption)}</figcaption></figure>'
        )
    parts += section.tables
    for title, text in section.folded.items():
        parts.append(f"<details><summary>{html.escape(title)}</summary><pre>{html.escape(text)}</pre></details>")
    return "\n".join(parts)


def _embedded(png: bytes) -> str:
    """A PNG in 256 colours of its own, a third of the size and hardly to be told apart, in Base64."""
    small = io.BytesIO()
    with Image.open(io.BytesIO(png)) as picture:
        picture.convert("RGB").quantize(256, dither=Image.Dither.NONE).save(small, "PNG", optimize=True)
    return base64.b64encode(small.getvalue()).decode("ascii")


def _cell(value: Any, digits: int, name: object) -> str:
    label = f' data-label="{html.escape(str(name))}"'
    if isinstance(value, str) and value in _BADGES:
        kind, text = _BADGES[value]
        return f'<td{label}><span class="badge {kind}">{text}</span></td>'
    if isinstance(value, float):
        text = "–" if math.isnan(value) else f"{value:.{digits}g}".replace("-", "\N{MINUS SIGN}")
        return f'<td class="number"{label}>{text}</td>'
    return f"<td{label}>{html.escape(str(value))}</td>"
