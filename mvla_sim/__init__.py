"""mvla-sim: phase-free geometry reconstruction from radio channels.

The stages, in the order data flows::

    scene ──► channel ──► imaging ──► evaluation ──► sweep ──► dataset ──► report
    mesh,      rays →      PDP →       contour,       plan,     draw,       figures
    views      CIR         image       score          run       shard

Names of the paper, of the code, and their units:

=================  =====================================  ==========
paper              code                                   unit
=================  =====================================  ==========
T_m                ``Views.positions_m[m]``               m
φ_m                ``Views.angles_deg[m]``                degree
τ_mi, R_mi         ``Cir.delay_s``, ``Peaks.range_m``     s, m
P_m(τ)             ``Pdp.power[m]``                       path gain
p_mi, w_mi         ``Peaks.power``, ``Peaks.weight``      path gain, 1
ΔR                 ``Pdp.resolution_m``                   m
κ, η, D            ``mvla.kappa, mvla.eta, extent_m``     1, 1, m
σ_R, R_T           ``sigma_m``, ``radius_m``              m
p_n                ``VoxelGrid.centers()[n]``             m
a_mn, b_mn         profile value, ``distance ≤ radius``   1
s_n, I_n^BP        ``Image.score``                        1
Θ_n                ``Image.support_deg``                  degree
p, T_θ             ``top_percent``, ``min_support_deg``   %, degree
CD                 ``Scores.cd_db``                       dB(m²)
=================  =====================================  ==========
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mvla_sim.channel.cir import Cir
    from mvla_sim.channel.components import Components
    from mvla_sim.channel.importing import import_channel, import_settings
    from mvla_sim.channel.loading import load_channel
    from mvla_sim.channel.response import FrequencyResponse
    from mvla_sim.channel.simulate import simulate
    from mvla_sim.channel.synthesis import synthesize, write_sweeps
    from mvla_sim.dataset.access import open_dataset
    from mvla_sim.dataset.build import build_dataset
    from mvla_sim.dataset.score import score_dataset
    from mvla_sim.errors import MvlaError
    from mvla_sim.evaluation.boxes import bounding_box
    from mvla_sim.evaluation.evaluate import EvaluationSettings, evaluate
    from mvla_sim.imaging.image import Image
    from mvla_sim.imaging.imaging_settings import ImagingSettings, imaging_settings
    from mvla_sim.imaging.observation import Observation
    from mvla_sim.imaging.pipeline import observe, reconstruct
    from mvla_sim.imaging.volumes import export_image
    from mvla_sim.measured.process import load_process, process
    from mvla_sim.plot.curves import plot_curves
    from mvla_sim.plot.image_figures import plot_comparison, plot_image
    from mvla_sim.plot.scene_figures import plot_scene
    from mvla_sim.plot.style import save_figure
    from mvla_sim.plot.waterfall import plot_waterfall
    from mvla_sim.scene.antenna import Antenna, AntennaPattern
    from mvla_sim.scene.antennas.cuts import PatternCuts
    from mvla_sim.scene.antennas.horn import Horn
    from mvla_sim.scene.antennas.omni import Omni
    from mvla_sim.scene.antennas.pattern_file import PatternFile
    from mvla_sim.scene.material import CustomMaterial, ScatteringPattern
    from mvla_sim.scene.pointing import PointingSettings
    from mvla_sim.scene.radio import RadioSettings, RayTracingSettings
    from mvla_sim.scene.shape import Prism, Shape
    from mvla_sim.scene.shapes.car import Car
    from mvla_sim.scene.shapes.cylinder import Cylinder
    from mvla_sim.scene.shapes.mesh_file import MeshFile
    from mvla_sim.scene.shapes.polygon import Polygon
    from mvla_sim.scene.shapes.rectangle import Rectangle
    from mvla_sim.scene.shapes.square import Square
    from mvla_sim.scene.shapes.star import Star
    from mvla_sim.scene.shapes.triangle import Triangle
    from mvla_sim.scene.trajectories.arc import Arc
    from mvla_sim.scene.trajectories.circle import Circle
    from mvla_sim.scene.trajectories.line import Line
    from mvla_sim.scene.trajectories.poses import Poses
    from mvla_sim.scene.trajectories.positions import Positions
    from mvla_sim.scene.trajectories.turntable import Turntable
    from mvla_sim.scene.trajectory import Trajectory
    from mvla_sim.scene.views import Views
    from mvla_sim.scene.world import Scene, SceneObject, SceneSettings

__version__ = "0.1.0"

_HOMES = {
    "Antenna": "scene.antenna",
    "AntennaPattern": "scene.antenna",
    "Arc": "scene.trajectories.arc",
    "Car": "scene.shapes.car",
    "Cir": "channel.cir",
    "Circle": "scene.trajectories.circle",
    "Components": "channel.components",
    "CustomMaterial": "scene.material",
    "Cylinder": "scene.shapes.cylinder",
    "EvaluationSettings": "evaluation.evaluate",
    "FrequencyResponse": "channel.response",
    "Horn": "scene.antennas.horn",
    "Image": "imaging.image",
    "ImagingSettings": "imaging.imaging_settings",
    "Line": "scene.trajectories.line",
    "MeshFile": "scene.shapes.mesh_file",
    "MvlaError": "errors",
    "Observation": "imaging.observation",
    "Omni": "scene.antennas.omni",
    "PatternCuts": "scene.antennas.cuts",
    "PatternFile": "scene.antennas.pattern_file",
    "PointingSettings": "scene.pointing",
    "Polygon": "scene.shapes.polygon",
    "Poses": "scene.trajectories.poses",
    "Positions": "scene.trajectories.positions",
    "Prism": "scene.shape",
    "RadioSettings": "scene.radio",
    "RayTracingSettings": "scene.radio",
    "Rectangle": "scene.shapes.rectangle",
    "ScatteringPattern": "scene.material",
    "Scene": "scene.world",
    "SceneObject": "scene.world",
    "SceneSettings": "scene.world",
    "Shape": "scene.shape",
    "Square": "scene.shapes.square",
    "Star": "scene.shapes.star",
    "Trajectory": "scene.trajectory",
    "Triangle": "scene.shapes.triangle",
    "Turntable": "scene.trajectories.turntable",
    "Views": "scene.views",
    "bounding_box": "evaluation.boxes",
    "build_dataset": "dataset.build",
    "evaluate": "evaluation.evaluate",
    "export_image": "imaging.volumes",
    "imaging_settings": "imaging.imaging_settings",
    "import_channel": "channel.importing",
    "import_settings": "channel.importing",
    "list_settings": "listing",
    "load_channel": "channel.loading",
    "load_process": "measured.process",
    "observe": "imaging.pipeline",
    "open_dataset": "dataset.access",
    "plot_comparison": "plot.image_figures",
    "plot_curves": "plot.curves",
    "plot_image": "plot.image_figures",
    "plot_scene": "plot.scene_figures",
    "plot_waterfall": "plot.waterfall",
    "process": "measured.process",
    "reconstruct": "imaging.pipeline",
    "save_figure": "plot.style",
    "score_dataset": "dataset.score",
    "simulate": "channel.simulate",
    "synthesize": "channel.synthesis",
    "write_sweeps": "channel.synthesis",
}

__all__ = [
    "Antenna",
    "AntennaPattern",
    "Arc",
    "Car",
    "Cir",
    "Circle",
    "Components",
    "CustomMaterial",
    "Cylinder",
    "EvaluationSettings",
    "FrequencyResponse",
    "Horn",
    "Image",
    "ImagingSettings",
    "Line",
    "MeshFile",
    "MvlaError",
    "Observation",
    "Omni",
    "PatternCuts",
    "PatternFile",
    "PointingSettings",
    "Polygon",
    "Poses",
    "Positions",
    "Prism",
    "RadioSettings",
    "RayTracingSettings",
    "Rectangle",
    "ScatteringPattern",
    "Scene",
    "SceneObject",
    "SceneSettings",
    "Shape",
    "Square",
    "Star",
    "Trajectory",
    "Triangle",
    "Turntable",
    "Views",
    "bounding_box",
    "build_dataset",
    "evaluate",
    "export_image",
    "imaging_settings",
    "import_channel",
    "import_settings",
    "list_settings",
    "load_channel",
    "load_process",
    "observe",
    "open_dataset",
    "plot_comparison",
    "plot_curves",
    "plot_image",
    "plot_scene",
    "plot_waterfall",
    "process",
    "reconstruct",
    "save_figure",
    "score_dataset",
    "simulate",
    "synthesize",
    "write_sweeps",
]


def _choose_libllvm() -> None:
    """Let whatever imports Dr.Jit later, as Sionna does, load a libLLVM it works with; nothing is loaded here."""
    if "drjit" not in sys.modules and not os.environ.get("DRJIT_LIBLLVM_PATH"):
        from mvla_sim.engine.llvm import preset  # noqa: PLC0415 - not where the user has chosen

        preset()


def __getattr__(name: str) -> Any:
    """Import a public name from its module on first use, so that ``import mvla_sim`` is quick."""
    if name not in _HOMES:
        raise AttributeError(f"module 'mvla_sim' has no attribute {name!r}")
    return getattr(importlib.import_module(f"mvla_sim.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])


_choose_libllvm()
