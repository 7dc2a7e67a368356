"""Which traced paths an image is made of, and how rough surfaces are, without tracing anew."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from mvla_sim.channel.cir import INTERACTIONS, Cir
from mvla_sim.channel.components import Components
from mvla_sim.channel.diffraction import DiffractedGain, diffracted_gain
from mvla_sim.channel.loading import Channel
from mvla_sim.errors import ConfigError, DataError, MvlaError
from mvla_sim.scene.world import Scene, SceneSettings
from mvla_sim.settings import Settings, parse

__all__ = ["PathSettings", "choose_paths"]

_AGREES: Final = 5e-3  # of a diffracted gain as it was traced, in float32, and in closed form


InteractionNames = tuple[Literal["specular", "diffuse", "refraction", "diffraction"], ...]


def _split(value: Any) -> Any:
    """Interactions of one text, as axes, which have no lists, give them."""
    if isinstance(value, str):
        return tuple(value.split("+"))
    return tuple(value) if isinstance(value, list) else value


class PathSettings(Settings):
    """What is made of the paths of a traced channel before anything else; by default they are taken as they are.

    A scattering coefficient acts first, then the choice of interactions, then the number of paths.
    """

    scattering_coefficient: Annotated[float, Field(ge=0, le=1)] | None = Field(
        None,
        description="S of all objects, instead of that of the scene: traced paths of depth 1 are weighed, diffuse ones "
        "by S, specular ones by √(1 − S²), and nothing is traced anew; by default as traced",
    )
    interactions: Annotated[InteractionNames, BeforeValidator(_split), Field(min_length=1)] | None = Field(
        None,
        description="paths of these interactions alone, as ['specular', 'diffuse'] or, in an axis, 'specular+diffuse'; "
        "by default all",
    )
    strongest: Annotated[int, Field(ge=1)] | None = Field(
        None, description="paths kept a view, as ray tracers that store a limited number do, often 25; by default all"
    )

    @property
    def acting(self) -> tuple[str, ...]:
        """Names of the settings that are set."""
        return tuple(name for name in type(self).model_fields if getattr(self, name) is not None)


def choose_paths(channel: Channel, settings: PathSettings) -> Channel:
    """Return the channel with its paths weighed and chosen; the channel itself where nothing is set.

    Raises
    ------
    ConfigError
        Something is set and the channel has no traced paths, or its paths cannot be weighed: they were traced with
        several interactions each or objects of different S, what is asked for was not traced, or the file does not say.
    DataError
        No path is left, or its diffracted paths are not those of the scene that it says it was traced in.

    Notes
    -----
    With R = √(1 − S²) and S_0, R_0 as traced, a diffuse path's gain is multiplied by S/S_0 and a specular one's by
    R/R_0, as the model of effective roughness that Sionna RT traces with (Degli-Esposti et al., IEEE TAP 55(1), 2007)
    divides the reflected field. A diffracted path's gain is affine in R, see
    :func:`~mvla_sim.channel.diffraction.diffracted_gain`. Paths of no gain are left out, as the tracer does.

    Of equally strong paths the earlier ones are kept.
    """
    if not settings.acting:
        return channel
    if not isinstance(channel, Cir):
        name = settings.acting[0]
        what = "ready-made components" if isinstance(channel, Components) else "measured frequency responses"
        raise ConfigError(f"{_shown(settings, name)}: needs traced paths, and this file holds {what}")
    if settings.scattering_coefficient is not None:
        channel = _scattering(channel, settings.scattering_coefficient)
    if settings.interactions is not None:
        channel = _of_kinds(channel, settings)
    if settings.strongest is not None:
        channel = _kept(channel, _strongest(channel, settings.strongest))
    return channel


def _shown(settings: PathSettings, name: str) -> str:
    value = getattr(settings, name)
    return f"paths.{name} = {list(value) if isinstance(value, tuple) else value}"


def _kept(cir: Cir, keep: NDArray[np.bool_]) -> Cir:
    """The channel with some of its paths, ``[n_path]``."""
    if keep.all():
        return cir
    kept = np.flatnonzero(keep)
    return replace(
        cir,
        gain=cir.gain[kept],
        delay_s=cir.delay_s[kept],
        interaction=cir.interaction[kept],
        first_point_m=cir.first_point_m[kept],
        row_size=np.diff(np.searchsorted(kept, cir.row_start)),
    )


def _of_kinds(cir: Cir, settings: PathSettings) -> Cir:
    shown = _shown(settings, "interactions")
    if (unknown := int((cir.interaction == 0).sum())) > 0:
        raise ConfigError(f"{shown}: this file does not tell the interactions of {unknown} of its paths")
    chosen = sum(INTERACTIONS[name] for name in set(settings.interactions or ()))
    keep = (cir.interaction & ~np.uint8(chosen)) == 0
    if not keep.any():
        bits = np.bitwise_or.reduce(cir.interaction, initial=0)
        there = ", ".join(name for name, bit in INTERACTIONS.items() if bits & bit) or "none"
        raise DataError(f"{shown}: no path of the channel has these interactions alone; interactions there: {there}")
    return _kept(cir, keep)


def _strongest(cir: Cir, count: int) -> NDArray[np.bool_]:
    """Which paths are among the strongest of their view, ``[n_path]``."""
    power = cir.gain.real.astype(np.float64) ** 2 + cir.gain.imag.astype(np.float64) ** 2
    keep = np.ones(power.size, bool)
    for view in np.flatnonzero(cir.row_size > count):
        rows = cir.rows(int(view))
        least = np.partition(power[rows], -count)[-count]
        kept = power[rows] > least
        kept[np.flatnonzero(power[rows] == least)[: count - int(kept.sum())]] = True
        keep[rows] = kept
    return keep


def _scattering(cir: Cir, wanted: float) -> Cir:
    """The channel as if all objects had been traced with S = ``wanted``."""
    shown = f"paths.scattering_coefficient = {wanted:g}"
    if not cir.config.get("objects"):
        raise ConfigError(f"{shown}: this file does not say which scattering coefficient it was traced with")
    scene = parse(SceneSettings, cir.config, "settings of the channel")
    traced = {item.scattering_coefficient for item in scene.objects}
    if traced == {wanted}:
        return cir
    if len(traced) > 1:
        values = ", ".join(f"{value:g}" for value in sorted(traced))
        raise ConfigError(f"{shown}: objects were traced with different ones ({values}); trace them anew")
    (before,) = traced
    if scene.ray_tracing.max_depth > 1:
        raise ConfigError(
            f"{shown}: paths were traced with ray_tracing.max_depth = {scene.ray_tracing.max_depth}; allowed: 1"
        )
    if wanted > 0 and not (scene.ray_tracing.diffuse and before > 0):
        why = f"scattering_coefficient = {before:g}" if scene.ray_tracing.diffuse else "ray_tracing.diffuse = false"
        raise ConfigError(f"{shown}: no diffuse path was traced, as {why}; allowed: 0")
    if before == 1:
        raise ConfigError(f"{shown}: nothing but diffuse paths was traced, as scattering_coefficient = 1; allowed: 1")
    smooth = tuple(float(np.sqrt(1 - value**2)) for value in (before, wanted))
    factors = np.ones(256, np.float32)  # by interaction
    factors[INTERACTIONS["diffuse"]] = wanted / before if before else 0.0
    factors[INTERACTIONS["specular"]] = smooth[1] / smooth[0]
    gain = cir.gain * factors[cir.interaction]
    if (cir.interaction == INTERACTIONS["diffraction"]).any():
        try:
            parts = diffracted_gain(cir, Scene(scene))
        except MvlaError as error:
            raise type(error)(f"{shown}: diffraction needs the scene that was traced: {error}") from error
        gain[parts.paths] = _diffracted(gain[parts.paths].astype(np.complex128), parts, smooth, shown)
    return _kept(replace(cir, gain=gain), gain != 0)


def _diffracted(
    traced: NDArray[np.complex128], parts: DiffractedGain, smooth: tuple[float, ...], shown: str
) -> NDArray[np.complex128]:
    """Gains of diffracted paths, ``[n]``, for another R = √(1 − S²); ``smooth`` is R as traced and as wanted."""
    before, wanted = smooth
    size = np.abs(parts.reflected) + np.abs(parts.fixed)
    off = np.abs(traced - (before * parts.reflected + parts.fixed))
    if not (off <= _AGREES * size).all():
        raise DataError(
            f"{shown}: of {traced.size} diffracted paths {int((off > _AGREES * size).sum())} are not those of the "
            "scene in the file's settings"
        )
    in_shadow = traced + (wanted - before) * parts.reflected
    return np.where(parts.fixed == 0, traced * (wanted / before), in_shadow)
