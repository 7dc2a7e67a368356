"""Run the cases of an experiment: trace each scene once, share the front end, score every image."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.simulate import simulate
from mvla_sim.config.scene import SceneSettings
from mvla_sim.evaluation.evaluate import Evaluation, evaluate
from mvla_sim.imaging.image import Image
from mvla_sim.imaging.pipeline import reconstruct
from mvla_sim.runtime.progress import progress
from mvla_sim.scene.world import Scene
from mvla_sim.sweep.plan import Case

__all__ = ["CaseResult", "run_cases", "table_of"]


@dataclass(frozen=True)
class CaseResult:
    """One finished case."""

    case: Case
    image: Image
    evaluation: Evaluation

    def row(self) -> dict[str, Any]:
        """Tidy row: the case's axis values, then thresholds and metrics."""
        return {"case": self.case.number, **self.case.values, "views": self.image.n_view, **self.evaluation.as_dict()}


def run_cases(cases: Sequence[Case], on_channel: Callable[[Scene, Cir], None] | None = None) -> Iterator[CaseResult]:
    """Run cases in order and yield each as it finishes.

    Parameters
    ----------
    cases
        The plan.
    on_channel
        Called once for each distinct scene with its CIR, for pictures of it.
    """
    settings: SceneSettings | None = None
    cir: Cir | None = None
    with progress("imaging and scoring", len(cases), "cases") as advance:
        for case in cases:
            if cir is None or settings != case.scene:
                scene = Scene.from_settings(case.scene)
                settings, cir = case.scene, simulate(scene)
                if on_channel is not None:
                    on_channel(scene, cir)
            image = reconstruct(cir, case.imaging)
            yield CaseResult(case, image, evaluate(image, case.evaluation))
            advance(1)


def table_of(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """One tidy table, one row a case."""
    return pd.DataFrame(list(rows))
