"""From a campaign to the scene of one of its samples: a function of seed and sample number alone.

Only uniform numbers in [0, 1) are taken from a sample's stream, and lengths and angles are rounded to six decimals, so
that the same sample is the same scene on machines whose sines differ in the last bit.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mvla_sim.dataset.campaign import (
    SPLITS,
    ArcCampaign,
    CampaignSettings,
    CircleFamily,
    FamilySettings,
    PolygonFamily,
    RectangleFamily,
    SmoothFamily,
    SquareFamily,
    StarFamily,
    TriangleFamily,
    TurntableCampaign,
)
from mvla_sim.dataset.outlines import random_polygon, smooth_outline
from mvla_sim.distributions import Choice, TextChoice, Uniform, WholeChoice, WholeUniform
from mvla_sim.errors import ConfigError
from mvla_sim.grid import VoxelGrid
from mvla_sim.scene.scene_settings import ObjectSettings, SceneSettings
from mvla_sim.scene.shapes import outline
from mvla_sim.scene.trajectory import build_views
from mvla_sim.scene.trajectory_settings import TrajectorySettings
from mvla_sim.settings import Settings, parse
from mvla_sim.streams import Stream, stream

__all__ = ["check_room", "draw_sample", "family_of", "split_of", "splits_of"]

PLACES: Final = 60
"""Places tried for each object before the whole sample is drawn anew."""
DRAWS: Final = 30
"""How often a whole sample is drawn before it fails."""
TRIED: Final = 10
"""Scenes of each family that are drawn before work starts, to find out whether there is room for any."""
DECIMALS: Final = 6
TRACING_SEEDS: Final = 2**31

Plain = dict[str, Any]


class _Object(Settings):
    object: ObjectSettings


class _Trajectory(Settings):
    trajectory: TrajectorySettings


def draw_sample(campaign: CampaignSettings, k: int) -> SceneSettings:
    """Draw the scene of sample ``k``.

    Parameters
    ----------
    campaign
        The campaign.
    k
        Number of the sample, from 0.

    Returns
    -------
    SceneSettings
        The same for the same (seed, k), in any order and on any machine.

    Raises
    ------
    ConfigError
        There is no such sample, or no room for its objects: after 30 draws of all of them, with 60 places tried for
        each, they still overlap, stick out of the grid, or come too near to the sensor.

    Notes
    -----
    Sizes and shapes are drawn before places, and only where no place is found anew. Still, where a grid is crowded,
    large objects are rarer than their distribution says.
    """
    _check_number(campaign, k)
    random = stream(campaign.seed, Stream.SAMPLE, k)
    family = _family(campaign, random)
    tracing_seed = _below(random, TRACING_SEEDS)
    objects, trajectory = _arrange(campaign, family, random, f"{campaign.name}: sample {k}")
    return _scene(campaign, k, objects, trajectory, tracing_seed)


def family_of(campaign: CampaignSettings, k: int) -> FamilySettings:
    """Family that sample ``k`` is drawn from."""
    _check_number(campaign, k)
    return _family(campaign, stream(campaign.seed, Stream.SAMPLE, k))


def check_room(campaign: CampaignSettings) -> None:
    """Refuse a campaign that has a family none of whose scenes can be drawn, judged by ten of each.

    Raises
    ------
    ConfigError
        As :func:`draw_sample`, of the first one.
    """
    for number, family in enumerate(campaign.families):
        failure: ConfigError | None = None
        for attempt in range(TRIED):
            random = stream(campaign.seed, Stream.SAMPLE, attempt, number)  # no sample's own stream
            try:
                _arrange(campaign, family, random, campaign.name)
            except ConfigError as error:
                failure = failure or error
            else:
                break
        else:
            assert failure is not None
            raise failure


def split_of(campaign: CampaignSettings, k: int) -> str:
    """Split of sample ``k``: ``train``, ``validation`` or ``test``.

    Examples
    --------
    >>> from mvla_sim.dataset.campaign import CampaignSettings, SquareFamily
    >>> family = SquareFamily(name="squares", shape="square", size_m=2.0)
    >>> campaign = CampaignSettings(name="c", samples=10, families=(family,))
    >>> sorted(split_of(campaign, k) for k in range(10))[-1]
    'validation'
    """
    _check_number(campaign, k)
    return SPLITS[int(_split_codes(campaign.seed, campaign.samples, _shares(campaign))[k])]


def splits_of(campaign: CampaignSettings) -> dict[str, NDArray[np.int64]]:
    """Numbers of the samples of each split, rising."""
    codes = _split_codes(campaign.seed, campaign.samples, _shares(campaign))
    return {name: np.flatnonzero(codes == number).astype(np.int64) for number, name in enumerate(SPLITS)}


def _shares(campaign: CampaignSettings) -> tuple[float, ...]:
    return campaign.split.train, campaign.split.validation, campaign.split.test


@functools.lru_cache(maxsize=4)
def _split_codes(seed: int, samples: int, shares: tuple[float, ...]) -> NDArray[np.int8]:
    """Index of each sample's split, ``[samples]``: exact shares of one permutation, largest remainders rounded up."""
    exact = np.array(shares) * samples
    counts = np.floor(exact + 1e-9).astype(np.int64)
    missing = samples - int(counts.sum())
    counts[np.argsort(-(exact - counts), kind="stable")[:missing]] += 1
    order = np.argsort(stream(seed, Stream.SPLIT).random(samples), kind="stable")
    codes = np.empty(samples, np.int8)
    codes[order] = np.repeat(np.arange(len(shares), dtype=np.int8), counts)
    codes.setflags(write=False)
    return codes


def _check_number(campaign: CampaignSettings, k: int) -> None:
    if not 0 <= k < campaign.samples:
        raise ConfigError(f"{campaign.name}: sample {k}: there is none; allowed: 0 to {campaign.samples - 1}")


def _scene(
    campaign: CampaignSettings, k: int, objects: Sequence[Plain], trajectory: TrajectorySettings, tracing_seed: int
) -> SceneSettings:
    data = {
        "name": f"{campaign.name}-{k:06d}",
        "objects": list(objects),
        "trajectory": trajectory.model_dump(mode="json"),
        "radio": campaign.radio.model_dump(mode="json"),
        "ray_tracing": campaign.ray_tracing.model_dump(mode="json") | {"seed": tracing_seed},
        "plane_height_m": campaign.grid.center_m[2],
    }
    return parse(SceneSettings, data, f"{campaign.name}: sample {k}")


def _below(random: np.random.Generator, count: int) -> int:
    """A whole number from 0 to below ``count``."""
    return min(int(random.random() * count), count - 1)


def _draw(distribution: Any, random: np.random.Generator) -> Any:
    """A value of a distribution; one number is taken from the stream whatever its kind."""
    share = random.random()
    if isinstance(distribution, Uniform):
        value = round(distribution.min + (distribution.max - distribution.min) * share, DECIMALS)
        return min(max(value, distribution.min), distribution.max)
    if isinstance(distribution, WholeUniform):
        return min(distribution.min + int(share * (distribution.max - distribution.min + 1)), distribution.max)
    if isinstance(distribution, Choice | WholeChoice | TextChoice):
        return distribution.choices[_weighted(distribution.weights or (1.0,) * len(distribution.choices), share)]
    return distribution


def _weighted(weights: Sequence[float], share: float) -> int:
    """Index at which the running share of the weights passes ``share``."""
    ends = np.cumsum(weights)
    return min(int(np.searchsorted(ends, share * ends[-1], side="right")), len(weights) - 1)


def _family(campaign: CampaignSettings, random: np.random.Generator) -> FamilySettings:
    return campaign.families[_weighted([family.weight for family in campaign.families], random.random())]


def _arrange(
    campaign: CampaignSettings, family: FamilySettings, random: np.random.Generator, source: str
) -> tuple[list[Plain], TrajectorySettings]:
    """Objects of a sample in their places, and its trajectory."""
    count = _draw(family.objects, random)
    for _ in range(DRAWS):
        trajectory = _trajectory(campaign, random)
        try:
            objects = _place(campaign, family, count, _sensors(campaign, trajectory, source), random)
        except ConfigError as error:
            raise ConfigError(f"{source}: family '{family.name}': {error}") from error
        if objects is not None:
            return objects, trajectory
    raise ConfigError(
        f"{source}: family '{family.name}': no room for {count} object{'s' * (count > 1)} after {DRAWS} draws of "
        f"{PLACES} places; lower its objects or size_m, or enlarge grid.size_m or trajectory.radius_m"
    )


def _trajectory(campaign: CampaignSettings, random: np.random.Generator) -> TrajectorySettings:
    """Trajectory of a sample."""
    settings = campaign.trajectory
    x, y, z = campaign.grid.center_m
    interval, height, separation, radius = (
        _draw(value, random)
        for value in (settings.interval_deg, settings.height_m, settings.pair_separation_m, settings.radius_m)
    )
    common: Plain = {"kind": settings.kind, "interval_deg": interval, "pair_separation_m": separation}
    if isinstance(settings, TurntableCampaign):
        data = common | {"sensor_m": [x + radius, y, z + height], "axis_m": [x, y]}
        return parse(_Trajectory, {"trajectory": data}, "trajectory").trajectory
    start = _draw(settings.start_deg, random)
    data = common | {"radius_m": radius, "start_deg": start, "center_m": [x, y], "height_m": z + height}
    if isinstance(settings, ArcCampaign):
        data["stop_deg"] = start + _draw(settings.span_deg, random)
    return parse(_Trajectory, {"trajectory": data}, "trajectory").trajectory


def _sensors(campaign: CampaignSettings, trajectory: TrajectorySettings, source: str) -> BaseGeometry:
    """Where transmitters and receivers stand, seen from above, metres."""
    x, y, _ = campaign.grid.center_m
    views = build_views(trajectory, (x, y), f"{source}: trajectory")
    places = [views.positions_m] if views.receivers_m is None else [views.positions_m, views.receivers_m]
    found = shapely.MultiPoint(np.concatenate(places)[:, :2])
    shapely.prepare(found)
    return found


def _any_within(sensors: BaseGeometry, area: BaseGeometry, distance_m: float) -> bool:
    """Whether a sensor is within a distance of an area; where none is near its bounding box, this takes no time."""
    x, y = shapely.get_coordinates(sensors).T
    x0, y0, x1, y1 = area.bounds
    near = (x >= x0 - distance_m) & (x <= x1 + distance_m) & (y >= y0 - distance_m) & (y <= y1 + distance_m)
    return bool(near.any() and shapely.dwithin(sensors, area, distance_m))


def _place(
    campaign: CampaignSettings,
    family: FamilySettings,
    count: int,
    sensors: BaseGeometry,
    random: np.random.Generator,
) -> list[Plain] | None:
    """Objects that keep their distances, or None where one finds no place."""
    low, high = VoxelGrid.from_settings(campaign.grid).bounds_m()
    inside = shapely.box(low[0], low[1], high[0], high[1])
    shapely.prepare(inside)
    placed: list[Plain] = []
    areas: list[BaseGeometry] = []
    for _ in range(count):
        form = _form(family, random) | {
            "height_m": _draw(family.height_m, random),
            "material": _draw(family.material, random),
            "scattering_coefficient": _draw(family.scattering_coefficient, random),
        }
        shape = outline(_object(form))
        for _ in range(PLACES):
            pose = _pose(campaign, family, random)
            area = _moved(shape, pose)
            if (
                shapely.covers(inside, area)
                and not _any_within(sensors, area, campaign.sensor_gap_m)
                and not any(shapely.dwithin(other, area, campaign.object_gap_m) for other in areas)
            ):
                placed.append(form | pose)
                shapely.prepare(area)
                areas.append(area)
                break
        else:
            return None
    return placed


def _object(form: Plain) -> ObjectSettings:
    return parse(_Object, {"object": form}, "object").object


def _pose(campaign: CampaignSettings, family: FamilySettings, random: np.random.Generator) -> Plain:
    x, y, z = campaign.grid.center_m
    place = [x + _draw(family.x_m, random), y + _draw(family.y_m, random), z]
    return {"position_m": place, "rotation_deg": _draw(family.rotation_deg, random)}


def _moved(shape: BaseGeometry, pose: Plain) -> BaseGeometry:
    """An outline turned about its object's centre and put in its place."""
    turn = math.radians(pose["rotation_deg"])
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    return shapely.transform(shape, lambda xy: xy @ rotation.T + pose["position_m"][:2])


def _form(family: FamilySettings, random: np.random.Generator) -> Plain:
    """Shape and size of one object, as in a scene file."""
    size = _draw(family.size_m, random)
    if isinstance(family, CircleFamily):
        return {"shape": "circle", "radius_m": size / 2, "facets": family.facets}
    if isinstance(family, SquareFamily):
        return {"shape": "square", "side_m": size}
    if isinstance(family, RectangleFamily):
        return {"shape": "rectangle", "length_m": size, "width_m": _rounded(size * _draw(family.aspect, random))}
    if isinstance(family, TriangleFamily):
        return {"shape": "triangle", "altitude_m": _rounded(size * math.sqrt(3) / 2)}
    if isinstance(family, StarFamily):
        points, ratio = _draw(family.points, random), _draw(family.inner_ratio, random)
        inner = _rounded(size / 2 * ratio)
        return {"shape": "star", "points": points, "radius_m": size / 2, "inner_radius_m": inner}
    if isinstance(family, PolygonFamily):
        corners, roughness = _draw(family.corners, random), _draw(family.roughness, random)
        vertices = random_polygon(random, corners, roughness)
    else:
        assert isinstance(family, SmoothFamily)
        harmonics, roughness = _draw(family.harmonics, random), _draw(family.roughness, random)
        vertices = smooth_outline(random, harmonics, roughness, family.facets)
    return {"shape": "polygon", "vertices_m": np.round(size / 2 * vertices, DECIMALS).tolist()}


def _rounded(length_m: float) -> float:
    return max(round(length_m, DECIMALS), 10.0**-DECIMALS)
