"""How every picture looks and how it is written: sizes, fonts, colours, file formats."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from mvla_sim.errors import ConfigError, check_argument
from mvla_sim.files import as_path, atomic_output

__all__ = [
    "COLORS", "DOUBLE_COLUMN_IN", "FIGURE_SUFFIXES", "MAPS", "PNG_DPI", "SINGLE_COLUMN_IN", "Canvas", "Given",
    "figure_legend", "figure_style", "figure_title", "new_figure", "png_bytes", "room_above_in", "save_figure",
]  # fmt: skip

SINGLE_COLUMN_IN = 3.5
"""Width of one column of an IEEE journal, inches."""
DOUBLE_COLUMN_IN = 7.16
"""Width of a page of an IEEE journal, both columns and the gap between them, inches."""
PNG_DPI = 200
"""Dots an inch of a PNG."""
VECTOR_DPI = 400
"""Dots an inch of the maps inside a PDF or SVG; lines and text have no resolution there."""
FIGURE_SUFFIXES = (".pdf", ".png", ".svg")

COLORS = {
    "blue": "#0072B2",
    "vermilion": "#D55E00",
    "green": "#009E73",
    "purple": "#CC79A7",
    "orange": "#E69F00",
    "sky": "#56B4E9",
    "black": "#000000",
    "grey": "#999999",
}
"""Colours that the common forms of colour blindness keep apart (Okabe and Ito 2008), and grey."""
MAPS = {"score": "inferno", "support": "viridis", "power": "inferno", "ordered": "viridis"}
"""Perceptually uniform colour maps, one for each kind of quantity."""

_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so that every machine draws the same
    "font.size": 7,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "legend.fontsize": 6.5,
    "figure.titlesize": 8,
    "axes.linewidth": 0.6,
    "axes.titlepad": 4,
    "axes.labelpad": 2,
    "grid.linewidth": 0.4,
    "grid.color": "#D9D9D9",
    "lines.linewidth": 1.1,
    "lines.markersize": 3.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.minor.size": 1.5,
    "ytick.minor.size": 1.5,
    "legend.frameon": False,
    "legend.handlelength": 2.2,
    "legend.columnspacing": 1.2,
    "figure.constrained_layout.h_pad": 0.03,
    "figure.constrained_layout.w_pad": 0.05,
    "text.parse_math": False,  # a $ in a name is a $
    "pdf.fonttype": 42,  # TrueType: publishers refuse Type 3
    "svg.fonttype": "path",  # text looks the same where the font is missing
    "svg.hashsalt": "mvla-sim",  # else the identifiers inside an SVG are random
}
_METADATA: dict[str, dict[str, Any]] = {
    ".pdf": {"CreationDate": None},
    ".png": {"Software": None},
    ".svg": {"Date": None},
}


@contextlib.contextmanager
def figure_style() -> Iterator[None]:
    """Draw in the package's style inside the block, whatever the user's own settings are; they are back after it."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


Canvas = Figure | SubFigure
"""What panels are put into: a figure, or a part of one."""
Given = TypeVar("Given", bound=Canvas)
"""The one that a function was given, and returns; without any it returns a new figure."""


class _ShownFigure(Figure):
    """A figure that a notebook shows by itself; no window, no pyplot."""

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        width, height = (round(100 * inches) for inches in self.get_size_inches())  # half as many points as there are
        return png_bytes(self), {"width": width, "height": height}


def new_figure(width_in: float, height_in: float, *, constrained: bool = True) -> Figure:
    """Return an empty figure of the given size in inches; it needs no display, and notebooks show it.

    ``constrained``: panels are placed when the figure is drawn, so that nothing overlaps.
    """
    figure = _ShownFigure(figsize=(width_in, height_in), layout="constrained" if constrained else None)
    FigureCanvasAgg(figure)
    return figure


def figure_legend(figure: Canvas, handles: Sequence[Artist], side: str = "lower", columns: int | None = None) -> None:
    """Put a legend below all panels of a figure, or above them (``side="upper"``); by default as wide as it fits."""
    if columns is None:
        longest = max(len(str(handle.get_label())) for handle in handles)
        fitting = int(figure.bbox.width / figure.dpi * 20 / (longest + 6))  # about 20 letters an inch, 6 for the line
        columns = max(1, min(fitting, len(handles)))
    outside = "outside " if isinstance(figure.get_layout_engine(), ConstrainedLayoutEngine) else ""
    place: Any = f"{outside}{side} center"
    figure.legend(handles=list(handles), loc=place, ncols=columns)


def room_above_in(title: str) -> float:
    """Height that panels leave free above them for their own titles and, where there is one, the figure's; inches."""
    return 0.45 if title else 0.25


def figure_title(figure: Canvas, title: str) -> None:
    """Put a title into the room above all panels; nothing where it is empty."""
    if title:
        figure.suptitle(title, y=1 - 0.06 * figure.dpi / figure.bbox.height, va="top")


def png_bytes(figure: Figure) -> bytes:
    """Return a figure as a PNG, the bytes that :func:`save_figure` would write."""
    buffer = io.BytesIO()
    with figure_style():
        figure.savefig(buffer, format="png", dpi=PNG_DPI, metadata=_METADATA[".png"])
    return buffer.getvalue()


def save_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure in the format of the file's suffix, under a temporary name that is then renamed.

    The same figure gives the same bytes: no time is written into it. A PNG has 200 dots an inch, so its size in pixels
    is 200 times the figure's in inches.

    Raises
    ------
    ConfigError
        The suffix is none of ``.pdf``, ``.png``, ``.svg``.
    OutputError
        The file cannot be written.
    """
    check_argument("figure", figure, Figure, "see plot_image")
    target = as_path(path)
    suffix = target.suffix.lower()
    if suffix not in FIGURE_SUFFIXES:
        given = f"suffix '{target.suffix}'" if target.suffix else "no suffix"
        raise ConfigError(f"{target}: a picture with {given}; allowed: {', '.join(FIGURE_SUFFIXES)}")
    dpi = PNG_DPI if suffix == ".png" else VECTOR_DPI
    with figure_style(), atomic_output(target) as temporary:
        figure.savefig(temporary, format=suffix[1:], dpi=dpi, metadata=_METADATA[suffix])
