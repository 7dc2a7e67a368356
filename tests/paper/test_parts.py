"""The paper's figures can be parts of others, and show in a notebook."""

from __future__ import annotations

import itertools

import pandas as pd
import pytest
from matplotlib.figure import Figure

from mvla_sim.paper.ablation import plot_ablation
from mvla_sim.paper.fair import plot_fair
from mvla_sim.paper.panels import plot_cd_panels, plot_parameter_maps

POINTS = itertools.product((0.0, 20.0), (1.0, 30.0), ("mvla-gr", "bp"), range(2))
STAR = pd.DataFrame(POINTS, columns=["snr_db", "interval_deg", "method", "seed"]).assign(
    cd_db=lambda table: -table["interval_deg"] - table["seed"], status="done", scene="star"
)
MAP = pd.DataFrame(itertools.product(("circle",), (0.3, 0.5), (0.02, 0.04)), columns=["scene", "kappa", "eta"]).assign(
    cd_db=lambda table: -table["kappa"]
)
FAIR = pd.DataFrame({"oracle": [-20.0, -10.0], "ap_10cm": [0.9, 0.5]}, index=["mvla-gr", "bp"])
DRAWN = {
    "CD panels": lambda **more: plot_cd_panels(STAR, **more),
    "one CD panel": lambda **more: plot_cd_panels(STAR, only=20.0, **more),
    "maps": lambda **more: plot_parameter_maps(MAP, **more),
    "one map": lambda **more: plot_parameter_maps(MAP, "circle", **more),
    "ablation": lambda **more: plot_ablation(STAR, **more),
    "fair": lambda **more: plot_fair(FAIR, **more),
}


@pytest.mark.parametrize("name", DRAWN)
@pytest.mark.parametrize("layout", [None, "constrained"])
def test_a_part_of_a_figure_is_drawn_into_and_returned(name, layout):
    above, below = Figure(figsize=(8, 8), layout=layout).subfigures(2, 1)
    assert DRAWN[name](figure=above) is above
    assert above.axes
    assert not below.axes
    above.figure.canvas.draw()
    assert DRAWN[name]()._repr_png_()[0].startswith(b"\x89PNG")
