"""From an experiment's axes to its list of cases. Nothing is computed here; everything is checked."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field

from mvla_sim.config.base import assign, parse
from mvla_sim.config.experiment import AxisValue, ExperimentSettings
from mvla_sim.config.imaging import SHORT_NAMES, EvaluationSettings, ImagingSettings
from mvla_sim.config.scene import SceneSettings, load_scene
from mvla_sim.errors import ConfigError

__all__ = ["Case", "expand"]


@dataclass(frozen=True)
class Case:
    """One point of a sweep.

    Attributes
    ----------
    number
        Place in the plan, from 0.
    scene, imaging, evaluation
        Complete, validated settings.
    values
        Scene name and the axis values of this case.
    """

    number: int
    scene: SceneSettings
    imaging: ImagingSettings
    evaluation: EvaluationSettings
    values: Mapping[str, AxisValue] = field(default_factory=dict)


def expand(experiment: ExperimentSettings) -> list[Case]:
    """Return the product of scenes and axes, in the order of the file, every case validated.

    Raises
    ------
    ConfigError
        An axis names no setting, or a value of it is not allowed; nothing has run by then.
    """
    keys = {axis: _dotted(axis, experiment) for axis in experiment.axes}
    blocks = {
        "imaging": experiment.imaging.model_dump(mode="json"),
        "evaluation": experiment.evaluation.model_dump(mode="json"),
    }
    cases: list[Case] = []
    for file in experiment.scenes:
        scene = load_scene(file)
        for values in itertools.product(*experiment.axes.values()):
            chosen = dict(zip(experiment.axes, values, strict=True))
            data = {name: _copy(block) for name, block in blocks.items()}
            scene_settings = scene.model_dump(mode="json") if any(k.startswith("scene.") for k in keys.values()) else {}
            data["scene"] = scene_settings
            source = f"experiment {experiment.name}: axes"
            for axis, value in chosen.items():
                assign(data, keys[axis], value, f"{source}.{axis}")
            cases.append(
                Case(
                    number=len(cases),
                    scene=parse(SceneSettings, scene_settings, source) if scene_settings else scene,
                    imaging=parse(ImagingSettings, data["imaging"], source),
                    evaluation=parse(EvaluationSettings, data["evaluation"], source),
                    values={"scene": scene.name, **chosen},
                )
            )
    return cases


def _dotted(axis: str, experiment: ExperimentSettings) -> str:
    """Full dotted key of an axis."""
    if axis in SHORT_NAMES:
        return f"imaging.{SHORT_NAMES[axis]}"
    if axis.partition(".")[0] in ("imaging", "evaluation", "scene") and "." in axis:
        return axis
    raise ConfigError(
        f"experiment {experiment.name}: axes.{axis}: names no setting; allowed: {', '.join(sorted(SHORT_NAMES))}, or a "
        f"dotted key that begins with imaging., evaluation. or scene."
    )


def _copy(block: dict[str, object]) -> dict[str, object]:
    return {key: _copy(value) if isinstance(value, dict) else value for key, value in block.items()}
