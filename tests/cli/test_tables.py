"""Tables of the command line: no name and no number is cut off, in no terminal and no pipe."""

from __future__ import annotations

import io
import re

import pandas as pd
import pytest
from rich.console import Console
from rich.table import Table

from mvla_sim.cli import dataset_commands, options

METHODS = ["bp-normalised", "bp-coherent", "bp-coherence", "a-method-of-somebody-elses-with-a-long-name"]


def wide():
    table = Table("scene", "method", "imaging.impairments.position_error_m", "CD dB(m²)", "p %", "cases", title="t")
    for number, name in enumerate(METHODS):
        table.add_row("star", name, "0.001", f"-1{number}.25", "[1.0, 2.0]", str(number))
    return table


def leaderboard():
    row = {"cd_db": -12.3, "cd_db_lo": -13.4, "cd_db_hi": -11.2, "behind_db": 1.5, "behind_db_lo": 1.0,
           "behind_db_hi": 2.0, "f1_10cm": 0.91, "empty": 0, "failed": 0}  # fmt: skip
    return dataset_commands._leaderboard(pd.DataFrame([row | {"method": name} for name in METHODS]), "small")


def columns_of(text):
    """What each column holds from top to bottom, folds and headings and all."""
    rows = [re.split("[│┃]", line)[1:-1] for line in text.splitlines() if re.search("[│┃]", line)]
    return ["".join(cell.strip() for cell in column) for column in zip(*rows, strict=True)]


@pytest.mark.parametrize("make", [wide, leaderboard])
@pytest.mark.parametrize("width", [60, 80, None])
def test_every_cell_can_be_read(monkeypatch, make, width):
    file = io.StringIO()
    terminal = width is not None
    console = Console(file=file, width=width, force_terminal=terminal, color_system=None, soft_wrap=True)
    monkeypatch.setattr(options, "out", console)
    options.show(make())
    text = file.getvalue()
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= (width or options.WIDE)
    cells = {cell for column in make().columns for cell in [*column.cells, column.header]}
    found = columns_of(text)
    for cell in cells:
        assert any(cell.replace(" ", "") in column.replace(" ", "") for column in found), cell
    if not terminal:
        assert all(re.search(rf"\b{name}\b", text) for name in METHODS), "a row is a line in a pipe"
