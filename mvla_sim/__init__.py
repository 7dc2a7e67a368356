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
    from mvla_sim.channel.cir import Cir as Cir
    from mvla_sim.channel.components import Components as Components
    from mvla_sim.channel.impairments import ImpairmentSettings as ImpairmentSettings
    from mvla_sim.channel.importing import (
        ImportSettings as ImportSettings,
    )
    from mvla_sim.channel.importing import (
        import_channel as import_channel,
    )
    from mvla_sim.channel.importing import (
        import_settings as import_settings,
    )
    from mvla_sim.channel.loading import load_channel as load_channel
    from mvla_sim.channel.response import FrequencyResponse as FrequencyResponse
    from mvla_sim.channel.simulate import simulate as simulate
    from mvla_sim.channel.synthesis import (
        SynthesisSettings as SynthesisSettings,
    )
    from mvla_sim.channel.synthesis import (
        synthesize as synthesize,
    )
    from mvla_sim.channel.synthesis import (
        write_sweeps as write_sweeps,
    )
    from mvla_sim.dataset.access import open_dataset as open_dataset
    from mvla_sim.dataset.build import build_dataset as build_dataset
    from mvla_sim.dataset.campaign import CampaignSettings as CampaignSettings
    from mvla_sim.dataset.campaign import load_campaign as load_campaign
    from mvla_sim.dataset.score import score_dataset as score_dataset
    from mvla_sim.errors import (
        ConfigError as ConfigError,
    )
    from mvla_sim.errors import (
        DataError as DataError,
    )
    from mvla_sim.errors import (
        MvlaError as MvlaError,
    )
    from mvla_sim.errors import (
        MvlaWarning as MvlaWarning,
    )
    from mvla_sim.errors import (
        OutputError as OutputError,
    )
    from mvla_sim.evaluation.boxes import bounding_box as bounding_box
    from mvla_sim.evaluation.evaluate import (
        Evaluation as Evaluation,
    )
    from mvla_sim.evaluation.evaluate import (
        EvaluationSettings as EvaluationSettings,
    )
    from mvla_sim.evaluation.evaluate import (
        evaluate as evaluate,
    )
    from mvla_sim.evaluation.metrics import Scores as Scores
    from mvla_sim.grid import GridSettings as GridSettings
    from mvla_sim.grid import VoxelGrid as VoxelGrid
    from mvla_sim.imaging.beam import BeamSettings as BeamSettings
    from mvla_sim.imaging.detectors.local_maxima import LocalMaxima as LocalMaxima
    from mvla_sim.imaging.image import Image as Image
    from mvla_sim.imaging.imaging_settings import (
        ImagingSettings as ImagingSettings,
    )
    from mvla_sim.imaging.imaging_settings import (
        imaging_settings as imaging_settings,
    )
    from mvla_sim.imaging.likelihood import MvlaSettings as MvlaSettings
    from mvla_sim.imaging.method import Method as Method
    from mvla_sim.imaging.method import SumOverViews as SumOverViews
    from mvla_sim.imaging.noise import Noise as Noise
    from mvla_sim.imaging.noises.complex_gaussian import ComplexNoise as ComplexNoise
    from mvla_sim.imaging.noises.exponential import ExponentialNoise as ExponentialNoise
    from mvla_sim.imaging.noises.gaussian import GaussianNoise as GaussianNoise
    from mvla_sim.imaging.observation import Estimate as Estimate
    from mvla_sim.imaging.observation import Observation as Observation
    from mvla_sim.imaging.paths import PathSettings as PathSettings
    from mvla_sim.imaging.pdp import Pdp as Pdp
    from mvla_sim.imaging.pdp import PdpSettings as PdpSettings
    from mvla_sim.imaging.pdp import compute_pdp as compute_pdp
    from mvla_sim.imaging.peaks import PeakDetector as PeakDetector
    from mvla_sim.imaging.peaks import Peaks as Peaks
    from mvla_sim.imaging.pipeline import observe as observe
    from mvla_sim.imaging.pipeline import reconstruct as reconstruct
    from mvla_sim.imaging.projection import RangeProfiles as RangeProfiles
    from mvla_sim.imaging.threshold_rules.automatic import AutomaticThresholds as AutomaticThresholds
    from mvla_sim.imaging.threshold_rules.given import GivenThresholds as GivenThresholds
    from mvla_sim.imaging.thresholds import ThresholdRule as ThresholdRule
    from mvla_sim.imaging.view_selection import ViewSettings as ViewSettings
    from mvla_sim.imaging.volumes import export_image as export_image
    from mvla_sim.listing import list_settings as list_settings
    from mvla_sim.measured.process import (
        ProcessSettings as ProcessSettings,
    )
    from mvla_sim.measured.process import (
        load_process as load_process,
    )
    from mvla_sim.measured.process import (
        process as process,
    )
    from mvla_sim.plot.curves import plot_curves as plot_curves
    from mvla_sim.plot.image_figures import plot_comparison as plot_comparison
    from mvla_sim.plot.image_figures import plot_image as plot_image
    from mvla_sim.plot.scene_figures import plot_scene as plot_scene
    from mvla_sim.plot.style import save_figure as save_figure
    from mvla_sim.plot.volume_figure import plot_volume as plot_volume
    from mvla_sim.plot.waterfall import plot_waterfall as plot_waterfall
    from mvla_sim.scene.antenna import Antenna as Antenna
    from mvla_sim.scene.antenna import AntennaPattern as AntennaPattern
    from mvla_sim.scene.antennas.cuts import PatternCuts as PatternCuts
    from mvla_sim.scene.antennas.horn import Horn as Horn
    from mvla_sim.scene.antennas.omni import Omni as Omni
    from mvla_sim.scene.antennas.pattern_file import PatternFile as PatternFile
    from mvla_sim.scene.material import CustomMaterial as CustomMaterial
    from mvla_sim.scene.material import ScatteringPattern as ScatteringPattern
    from mvla_sim.scene.placing import SceneObject as SceneObject
    from mvla_sim.scene.pointing import PointingSettings as PointingSettings
    from mvla_sim.scene.radio import RadioSettings as RadioSettings
    from mvla_sim.scene.radio import RayTracingSettings as RayTracingSettings
    from mvla_sim.scene.shape import Prism as Prism
    from mvla_sim.scene.shape import Shape as Shape
    from mvla_sim.scene.shapes.car import Car as Car
    from mvla_sim.scene.shapes.cylinder import Cylinder as Cylinder
    from mvla_sim.scene.shapes.mesh_file import MeshFile as MeshFile
    from mvla_sim.scene.shapes.polygon import Polygon as Polygon
    from mvla_sim.scene.shapes.rectangle import Rectangle as Rectangle
    from mvla_sim.scene.shapes.square import Square as Square
    from mvla_sim.scene.shapes.star import Star as Star
    from mvla_sim.scene.shapes.triangle import Triangle as Triangle
    from mvla_sim.scene.trajectories.arc import Arc as Arc
    from mvla_sim.scene.trajectories.circle import Circle as Circle
    from mvla_sim.scene.trajectories.line import Line as Line
    from mvla_sim.scene.trajectories.poses import Poses as Poses
    from mvla_sim.scene.trajectories.positions import Positions as Positions
    from mvla_sim.scene.trajectories.turntable import Turntable as Turntable
    from mvla_sim.scene.trajectory import Trajectory as Trajectory
    from mvla_sim.scene.views import Views as Views
    from mvla_sim.scene.world import (
        Scene as Scene,
    )
    from mvla_sim.scene.world import (
        SceneSettings as SceneSettings,
    )
    from mvla_sim.scene.world import (
        load_scene as load_scene,
    )
    from mvla_sim.sweep.design_run import load_design as load_design
    from mvla_sim.sweep.experiment import ExperimentSettings as ExperimentSettings
    from mvla_sim.sweep.experiment import load_experiment as load_experiment
    from mvla_sim.sweep.run import run_experiment as run_experiment
    from mvla_sim.sweep.table import load_table as load_table

__version__ = "0.1.0"

_PUBLIC = {
    "channel.cir": "Cir",
    "channel.components": "Components",
    "channel.impairments": "ImpairmentSettings",
    "channel.importing": "ImportSettings import_channel import_settings",
    "channel.loading": "load_channel",
    "channel.response": "FrequencyResponse",
    "channel.simulate": "simulate",
    "channel.synthesis": "SynthesisSettings synthesize write_sweeps",
    "dataset.access": "open_dataset",
    "dataset.build": "build_dataset",
    "dataset.campaign": "CampaignSettings load_campaign",
    "dataset.score": "score_dataset",
    "errors": "ConfigError DataError MvlaError MvlaWarning OutputError",
    "evaluation.boxes": "bounding_box",
    "evaluation.evaluate": "Evaluation EvaluationSettings evaluate",
    "evaluation.metrics": "Scores",
    "grid": "GridSettings VoxelGrid",
    "imaging.beam": "BeamSettings",
    "imaging.detectors.local_maxima": "LocalMaxima",
    "imaging.image": "Image",
    "imaging.imaging_settings": "ImagingSettings imaging_settings",
    "imaging.likelihood": "MvlaSettings",
    "imaging.method": "Method SumOverViews",
    "imaging.noise": "Noise",
    "imaging.noises.complex_gaussian": "ComplexNoise",
    "imaging.noises.exponential": "ExponentialNoise",
    "imaging.noises.gaussian": "GaussianNoise",
    "imaging.observation": "Estimate Observation",
    "imaging.paths": "PathSettings",
    "imaging.pdp": "Pdp PdpSettings compute_pdp",
    "imaging.peaks": "PeakDetector Peaks",
    "imaging.pipeline": "observe reconstruct",
    "imaging.projection": "RangeProfiles",
    "imaging.threshold_rules.automatic": "AutomaticThresholds",
    "imaging.threshold_rules.given": "GivenThresholds",
    "imaging.thresholds": "ThresholdRule",
    "imaging.view_selection": "ViewSettings",
    "imaging.volumes": "export_image",
    "listing": "list_settings",
    "measured.process": "ProcessSettings load_process process",
    "plot.curves": "plot_curves",
    "plot.image_figures": "plot_comparison plot_image",
    "plot.scene_figures": "plot_scene",
    "plot.style": "save_figure",
    "plot.volume_figure": "plot_volume",
    "plot.waterfall": "plot_waterfall",
    "scene.antenna": "Antenna AntennaPattern",
    "scene.antennas.cuts": "PatternCuts",
    "scene.antennas.horn": "Horn",
    "scene.antennas.omni": "Omni",
    "scene.antennas.pattern_file": "PatternFile",
    "scene.material": "CustomMaterial ScatteringPattern",
    "scene.placing": "SceneObject",
    "scene.pointing": "PointingSettings",
    "scene.radio": "RadioSettings RayTracingSettings",
    "scene.shape": "Prism Shape",
    "scene.shapes.car": "Car",
    "scene.shapes.cylinder": "Cylinder",
    "scene.shapes.mesh_file": "MeshFile",
    "scene.shapes.polygon": "Polygon",
    "scene.shapes.rectangle": "Rectangle",
    "scene.shapes.square": "Square",
    "scene.shapes.star": "Star",
    "scene.shapes.triangle": "Triangle",
    "scene.trajectories.arc": "Arc",
    "scene.trajectories.circle": "Circle",
    "scene.trajectories.line": "Line",
    "scene.trajectories.poses": "Poses",
    "scene.trajectories.positions": "Positions",
    "scene.trajectories.turntable": "Turntable",
    "scene.trajectory": "Trajectory",
    "scene.views": "Views",
    "scene.world": "Scene SceneSettings load_scene",
    "sweep.design_run": "load_design",
    "sweep.experiment": "ExperimentSettings load_experiment",
    "sweep.run": "run_experiment",
    "sweep.table": "load_table",
}
"""Public names by the module that holds them, as type checkers see them above."""
_HOMES = {name: module for module, names in _PUBLIC.items() for name in names.split()}

__all__ = sorted(_HOMES, key=lambda name: (name[0].islower(), name))  # noqa: PLE0605 - a list, of the names above


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
