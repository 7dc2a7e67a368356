"""The card of a dataset with its picture."""

from __future__ import annotations

from pathlib import Path

from mvla_sim.dataset.access import BenchmarkDataset
from mvla_sim.dataset.card import CARD, PICTURE, card_text, shown_samples
from mvla_sim.files import atomic_output
from mvla_sim.plot.scene_figures import plot_samples
from mvla_sim.plot.style import save_figure

__all__ = ["write_card"]


def write_card(dataset: BenchmarkDataset) -> list[Path]:
    """Write README.md and the picture of some scenes into a dataset's directory, and return both files."""
    folder = dataset.index.folder
    save_figure(plot_samples([dataset[k] for k in shown_samples(dataset)]), folder / PICTURE)
    with atomic_output(folder / CARD) as temporary:
        temporary.write_text(card_text(dataset), encoding="utf-8")
    return [folder / CARD, folder / PICTURE]
