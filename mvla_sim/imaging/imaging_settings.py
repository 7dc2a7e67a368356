"""Settings from a channel impulse response to an image and its score. Every point the paper leaves open is here."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import (
    AfterValidator,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from mvla_sim.channel.impairments import ImpairmentSettings
from mvla_sim.grid import GridSettings
from mvla_sim.settings import Settings, apply_overrides, assign, parse

__all__ = [
    "LATER_BLOCKS",
    "METHOD_GROUP",
    "METHOD_NAMES",
    "SHORT_NAMES",
    "BeamSettings",
    "CarvingSettings",
    "EmSettings",
    "EvaluationSettings",
    "ImagingSettings",
    "MethodName",
    "MlemSettings",
    "MvlaSettings",
    "NnlsSettings",
    "NoiseSettings",
    "PdpSettings",
    "PeakSettings",
    "RpmSettings",
    "ThresholdSettings",
    "Thresholds",
    "ViewSettings",
    "imaging_settings",
    "split_method",
]

METHOD_NAMES: Final = (
    "mvla-gr",
    "mvla-hard",
    "bp",
    "hard-vote",
    "soft-kernel",
    "power-weights",
    "bp-peaks",
    "bp-normalised",
    "bp-gated",
    "bp-coherence",
    "bp-filtered",
    "carving",
    "rpm",
    "bp-coherent",
    "mlem",
    "nnls",
    "mvla-em",
)  # fmt: skip
"""Methods of this package; each is a module of :mod:`mvla_sim.imaging.methods`."""
LATER_BLOCKS: Final = ("impairments", "carving", "rpm", "mlem", "nnls", "em")
"""Blocks of imaging settings that came after sweeps were stored. At their defaults no dump has them, so keys, stores
and files are what they were without them."""
METHOD_GROUP: Final = "mvla_sim.methods"
"""Group of the entry points under which other packages offer methods."""


def split_method(name: str) -> tuple[Path, str] | None:
    """File and function of a method named ``file.py:function``; None for a name of another kind."""
    file, colon, function = name.rpartition(":")
    if not (colon and file.endswith(".py")):
        file, function = name, "image"
    return (Path(file).expanduser(), function) if file.endswith(".py") and function.isidentifier() else None


def _check_method(name: str) -> str:
    if name in METHOD_NAMES or split_method(name) is not None:
        return name
    offered = sorted(point.name for point in entry_points(group=METHOD_GROUP))
    if name in offered:
        return name
    raise ValueError(f"'{name}' is none; allowed: {', '.join((*METHOD_NAMES, *offered))}, or file.py:function")


MethodName = Annotated[str, AfterValidator(_check_method)]


class PdpSettings(Settings):
    """From paths to a band-limited power delay profile (``eq:PDP``)."""

    window: Literal["hann", "hamming", "blackman", "kaiser", "rectangular"] = "hann"
    kaiser_beta: Annotated[float, Field(ge=0, le=40, description="β of the Kaiser window")] = 6.0
    oversampling: Annotated[int, Field(ge=1, le=64, description="samples per 1/B of delay")] = 4
    gate_m: tuple[NonNegativeFloat, PositiveFloat] | None = Field(
        None, description="one-way range interval kept; by default the ranges at which the grid is seen"
    )

    @model_validator(mode="after")
    def _check(self) -> PdpSettings:
        if self.gate_m is not None and self.gate_m[0] >= self.gate_m[1]:
            raise ValueError(f"gate_m = {list(self.gate_m)} must be [near, far] with near below far")
        return self


class NoiseSettings(Settings):
    """Noise at a given SNR; the realisation depends on the seed and a view's place in the file alone."""

    snr_db: Annotated[float, Field(ge=-100, le=200)] | None = Field(20.0, description="'none': no noise")
    kind: Literal["gaussian", "exponential", "complex"] = Field(
        "gaussian",
        description="gaussian: white, zero mean, added to the PDP; exponential: noise power added to the PDP; "
        "complex: circular white noise added to the CIR before the squared magnitude",
    )
    reference: Literal["view", "all"] = Field("view", description="whose mean square is the signal: a view's or all's")
    seed: NonNegativeInt = 0


class PeakSettings(Settings):
    """Peak detector: local maxima above a noise floor that is estimated from the PDP itself."""

    threshold_sigma: PositiveFloat = Field(4.0, description="threshold above the median, in robust standard deviations")
    dynamic_range_db: PositiveFloat = Field(
        25.0, description="weaker peaks, relative to the strongest, are dropped: two Hann sidelobes reach -25.5 dB"
    )
    min_separation: NonNegativeFloat = Field(1.0, description="in resolution cells: 1/B times the window's broadening")
    max_peaks: Annotated[int, Field(ge=1)] | None = Field(None, description="keep the strongest; by default all")
    refine: bool = Field(True, description="move each peak to the vertex of the parabola through three samples")


class MvlaSettings(Settings):
    """MVLA-GR's kernel: σ_R = κ·ΔR (``eq:sigmaR_general``), R_T = max(σ_R, η·D) (``eq:RT_def_new``)."""

    kappa: PositiveFloat = 0.5
    eta: NonNegativeFloat = 0.04
    extent_m: PositiveFloat | None = Field(None, description="D; by default the target's extent in the CIR file")
    tolerance_m: PositiveFloat | None = Field(None, description="ε_R of the hard vote; by default ΔR")


class ViewSettings(Settings):
    """Which of a file's views are used: every ``interval_deg``, beginning with view number ``offset``."""

    interval_deg: PositiveFloat | None = Field(None, description="by default every view")
    offset: NonNegativeInt = 0


class BeamSettings(Settings):
    """Where a view's antennas reach; antennas without a pattern reach everywhere."""

    edge_db: Annotated[float, Field(lt=0)] | None = Field(
        -3.0,
        description="one-way level below the peak at which the covered sector ends, where nothing is projected any "
        "more; 'none': project everywhere",
    )


class CarvingSettings(Settings):
    """First-echo carving; see :mod:`mvla_sim.imaging.methods.carving`."""

    kernel: Annotated[float, Field(gt=0, le=100, description="width σ of a first echo, in ΔR")] = 0.5
    margin: Annotated[float, Field(ge=0, le=100, description="what a view carves ends so far before its first echo, "
                                   "in ΔR")] = 0.5  # fmt: skip
    share: Annotated[float, Field(ge=0, lt=1, description="a voxel is empty if more than this share of the views that "
                                  "cover it carve it")] = 0.01  # fmt: skip


class RpmSettings(Settings):
    """Range Points Migration; see :mod:`mvla_sim.imaging.methods.rpm`."""

    sigma_theta_deg: Annotated[float, Field(ge=0.01, le=30, description="σ_θ: how well directions must agree")] = 1.0
    sigma_x_m: Annotated[float, Field(gt=0, le=1e4, description="σ_X: how far away neighbouring views count")] = 4.0
    kernel: Annotated[float, Field(gt=0, le=100, description="width σ of a contour point on the grid, in ΔR")] = 1.0


class MlemSettings(Settings):
    """MLEM tomography of the profiles."""

    iterations: Annotated[int, Field(ge=1, le=10_000, description="steps; more sharpen the image, and the noise")] = 40


class NnlsSettings(Settings):
    """Non-negative least squares of the profiles."""

    iterations: Annotated[int, Field(ge=1, le=10_000, description="steps; more sharpen the image, and the noise")] = 20


class EmSettings(Settings):
    """MVLA-EM; see :mod:`mvla_sim.imaging.methods.mvla_em`."""

    iterations: Annotated[int, Field(ge=1, le=10_000, description="steps; more sharpen the image, and the noise")] = 8
    unexplained: Annotated[
        float, Field(gt=0, le=100, description="share of a view that may be explained by nothing")
    ] = 1.0


class ThresholdSettings(Settings):
    """Joint threshold (``eq:joint_thresholding_new``): the top p per cent of all voxels, then Θ ≥ T_θ."""

    top_percent: Annotated[float, Field(gt=0, le=100)] = 1.0
    min_support_deg: Annotated[float, Field(ge=0, le=360)] = 0.0


Thresholds = ThresholdSettings | Literal["auto"]
"""Given thresholds, or those that are chosen from the image; see :mod:`mvla_sim.imaging.automatic`."""


class ImagingSettings(Settings):
    """All settings of ``mvla image``."""

    method: MethodName = Field("mvla-gr", description=f"{' | '.join(METHOD_NAMES)} | file.py:function")
    grid: GridSettings = GridSettings()
    pdp: PdpSettings = PdpSettings()
    noise: NoiseSettings = NoiseSettings()
    peaks: PeakSettings = PeakSettings()
    mvla: MvlaSettings = MvlaSettings()
    views: ViewSettings = ViewSettings()
    beam: BeamSettings = BeamSettings()
    impairments: ImpairmentSettings = ImpairmentSettings()
    carving: CarvingSettings = CarvingSettings()
    rpm: RpmSettings = RpmSettings()
    mlem: MlemSettings = MlemSettings()
    nnls: NnlsSettings = NnlsSettings()
    em: EmSettings = EmSettings()
    threshold: Thresholds | None = Field(None, description="also write the binary image at these; 'auto': its own")

    @model_serializer(mode="wrap")
    def _without_later_blocks(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out blocks of :data:`LATER_BLOCKS` that are at their defaults."""
        data: dict[str, Any] = handler(self)
        fields = type(self).model_fields
        return {key: value for key, value in data.items()
                if key not in LATER_BLOCKS or getattr(self, key) != fields[key].default}  # fmt: skip


class EvaluationSettings(Settings):
    """What the image is compared with, and how."""

    truth: Literal["contour", "filled"] = "contour"
    distances_m: tuple[PositiveFloat, ...] = Field((0.05, 0.10), description="for precision, recall and F1")
    average_precision: bool = Field(
        False, description="also the area under precision and recall at the largest of these distances; no thresholds"
    )
    threshold_map: bool = Field(
        False, description="also the CD at every candidate pair (p, T_θ), for a calibration by the least mean"
    )
    threshold: Thresholds | None = Field(
        None, description="by default the optimum over every p and T_θ; 'auto': from the image, without the truth"
    )

    @model_serializer(mode="wrap")
    def _without_later_fields(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out what came after sweeps were stored, at its default; see :data:`LATER_BLOCKS`."""
        data: dict[str, Any] = handler(self)
        return {key: value for key, value in data.items() if key not in LATER_FIELDS or value}


LATER_FIELDS: Final = ("average_precision", "threshold_map")
"""Fields of :class:`EvaluationSettings` that are left out where they are false, for the same reason as
:data:`LATER_BLOCKS`."""

SHORT_NAMES: dict[str, str] = {
    "method": "method",
    "snr_db": "noise.snr_db",
    "seed": "noise.seed",
    "interval_deg": "views.interval_deg",
    "offset": "views.offset",
    "kappa": "mvla.kappa",
    "eta": "mvla.eta",
    "spacing_m": "grid.spacing_m",
    "threshold_sigma": "peaks.threshold_sigma",
}
"""Names that need no path: in ``imaging_settings``, as options of ``mvla image`` and as axes of an experiment."""


def imaging_settings(overrides: Sequence[str] = (), **values: Any) -> ImagingSettings:
    """Build imaging settings from short names and dotted keys; everything else keeps its default.

    Parameters
    ----------
    overrides
        ``dotted.key=value`` texts, as with ``--set``.
    **values
        By short name, for example ``imaging_settings(method="bp", snr_db=20, interval_deg=5)``, or by the name of a
        whole block, ``imaging_settings(pdp={"window": "hamming"})``.

    Raises
    ------
    ConfigError
        An unknown name or a value that is not allowed.
    """
    data: dict[str, Any] = {}
    for name, value in values.items():
        assign(data, SHORT_NAMES.get(name, name), "none" if value is None else value)
    return parse(ImagingSettings, apply_overrides(data, overrides), "imaging settings")
