"""Value objects print as one short line and compare without an exception."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import shapely

from mvla_sim.evaluation.evaluate import evaluate
from mvla_sim.evaluation.ground_truth import TruthGeometry
from mvla_sim.evaluation.metrics import score
from mvla_sim.evaluation.tuning import optimal_thresholds
from mvla_sim.grid import VoxelGrid
from mvla_sim.imaging.image import Image
from mvla_sim.measured.process import Processed
from mvla_sim.paper.claims import ResultTables
from mvla_sim.paper.page import Section
from mvla_sim.sweep.session import RunResult

GRID = VoxelGrid((0.0, 0.0, 0.0), (12, 12, 1), 0.25)
IMAGE = Image(np.random.default_rng(1).random(GRID.shape).astype(np.float32), None, GRID, "bp", 6,
              outline=shapely.box(-1, -1, 1, 1))  # fmt: skip
MASK = IMAGE.score > 0.5
TABLE = pd.DataFrame({"status": ["done", "failed"]})


def processed():
    return Processed(IMAGE, IMAGE, MASK, evaluate(IMAGE), None, None, None, {})


VALUES = {
    "evaluation": (lambda: evaluate(IMAGE), r"Evaluation\(optimal thresholds, p = .* %, T_θ = 0°: CD -?[\d.]+ dB"),
    "scores": (lambda: score(MASK, MASK, GRID), r"Scores\(CD -inf dB\(m²\), F1 1.00 at 5 cm, 1.00 at 10 cm\)"),
    "empty scores": (lambda: score(MASK, MASK & ~MASK, GRID), r"Scores\(the reconstruction is empty"),
    "truth": (lambda: TruthGeometry.build(MASK, GRID), r"TruthGeometry\(\d+ of 144 voxels\)"),
    "optimum": (lambda: optimal_thresholds(IMAGE.score, None, TruthGeometry.build(MASK, GRID)), r"Optimum\(CD "),
    "processed": (processed, r"Processed\(bp, 6 views, 144 voxels, CD "),
    "run": (lambda: RunResult(TABLE, (), ()), r"RunResult\(1 of 2 cases done\)"),
    "tables": (lambda: ResultTables(TABLE, checks={"c15": {}}), r"ResultTables\(kappa_eta: 2 cases, c15\)"),
    "section": (lambda: Section("Title", "text " * 100), r"Section\('Title'\)"),
}


@pytest.mark.parametrize("name", VALUES)
def test_one_short_line_and_an_answer_to_every_comparison(name):
    make, pattern = VALUES[name]
    one, other = make(), make()
    assert len(repr(one)) <= 100
    assert pd.Series([repr(one)]).str.match(pattern).all(), repr(one)
    assert one == one  # noqa: PLR0124 - arrays inside must not be asked
    assert (one == other) in (True, False)
    assert one != "something else"
    assert isinstance(hash(one), int)
