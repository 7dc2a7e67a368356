"""From a campaign to the scene of one of its samples: a function of seed and sample number alone.

Only uniform numbers in [0, 1) are taken from a sample's stream, and lengths and angles are rounded to six decimals, so
that the same sample is the same scene on machines whose sines differ in the last bit.
"""

from __future__ import annotations

import functools
import math
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mvla_sim.dataset.campaign import SPLITS, CampaignSettings
from mvla_sim.dataset.families import FamilySettings
from mvla_sim.distributions import draw, weighted
from mvla_sim.errors import ConfigError
from mvla_sim.grid import VoxelGrid
from mvla_sim.scene.shape import Prism
from mvla_sim.scene.trajectory import Trajectory
from mvla_sim.scene.world import SceneSettings
from mvla_sim.streams import Stream, stream

__all__ = ["check_room", "draw_sample", "family_of", "split_of", "splits_of"]

PLACES: Final = 60
"""Places tried for each object before the whole sample is drawn anew."""
DRAWS: Final = 30
"""How often a whole sample is drawn before it fails."""
TRIED: Final = 10
"""Scenes of each family that are drawn before work starts, to find out whether there is room for any."""
TRACING_SEEDS: Final = 2**31


def draw_sample(campaign: CampaignSettings, k: int) -> SceneSettings:
    """Draw the scene of sample ``k``.

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
    tracing_seed = int(random.random() * TRACING_SEEDS)
    objects, trajectory = _arrange(campaign, family, random, f"{campaign.name}: sample {k}")
    return SceneSettings(
        name=f"{campaign.name}-{k:06d}",
        objects=tuple(objects),
        trajectory=trajectory,
        radio=campaign.radio,
        ray_tracing=campaign.ray_tracing.model_copy(update={"seed": tracing_seed}),
        plane_height_m=campaign.grid.middle_m()[2],
    )


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
    >>> from mvla_sim.dataset.campaign import CampaignSettings
    >>> from mvla_sim.dataset.families import SquareFamily
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


def _family(campaign: CampaignSettings, random: np.random.Generator) -> FamilySettings:
    return campaign.families[weighted([family.weight for family in campaign.families], random.random())]


def _arrange(
    campaign: CampaignSettings, family: FamilySettings, random: np.random.Generator, source: str
) -> tuple[list[Prism], Trajectory]:
    """Objects of a sample in their places, and its trajectory."""
    count = draw(family.objects, random)
    for _ in range(DRAWS):
        trajectory = campaign.trajectory.drawn(campaign.grid.middle_m(), random)
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


def _sensors(campaign: CampaignSettings, trajectory: Trajectory, source: str) -> BaseGeometry:
    """Where transmitters and receivers stand, seen from above, metres."""
    x, y, _ = campaign.grid.middle_m()
    views = trajectory.build_views((x, y), f"{source}: trajectory")
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
) -> list[Prism] | None:
    """Objects that keep their distances, or None where one finds no place."""
    low, high = VoxelGrid.from_settings(campaign.grid).bounds_m()
    inside = shapely.box(low[0], low[1], high[0], high[1])
    shapely.prepare(inside)
    placed: list[Prism] = []
    areas: list[BaseGeometry] = []
    for _ in range(count):
        item = family.drawn(random)
        shape = item.outline()
        for _ in range(PLACES):
            pose = _pose(campaign, family, random)
            area = _moved(shape, pose)
            if (
                shapely.covers(inside, area)
                and not _any_within(sensors, area, campaign.sensor_gap_m)
                and not any(shapely.dwithin(other, area, campaign.object_gap_m) for other in areas)
            ):
                placed.append(item.model_copy(update=pose))
                shapely.prepare(area)
                areas.append(area)
                break
        else:
            return None
    return placed


def _pose(campaign: CampaignSettings, family: FamilySettings, random: np.random.Generator) -> dict[str, Any]:
    x, y, z = campaign.grid.middle_m()
    place = (x + draw(family.x_m, random), y + draw(family.y_m, random), z)
    return {"position_m": place, "rotation_deg": draw(family.rotation_deg, random)}


def _moved(shape: BaseGeometry, pose: dict[str, Any]) -> BaseGeometry:
    """An outline turned about its object's centre and put in its place."""
    turn = math.radians(pose["rotation_deg"])
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    return shapely.transform(shape, lambda xy: xy @ rotation.T + pose["position_m"][:2])
