"""Making shards: the samples of one file, traced, put into arrays, and encoded as NetCDF-4.

On disk, paths are a CF contiguous ragged array over views (``row_size``), and views one over samples (``view_count``).

Two checksums tell two things. ``sha256`` in the index covers the bytes of the file, as ``sha256sum`` does, and notices
any change. ``data_sha256`` covers names, types, shapes and values of the variables alone, so two builds of the same
data agree in it whenever they were made; provenance and time are in the file, but not in this one. It is kept in the
file too, so that a shard can be checked where there is no index.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import sys
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import dask
import numpy as np
import shapely
import xarray as xr
from numpy.typing import NDArray
from pydantic import NonNegativeInt
from rich.console import Console

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.header import HEADER
from mvla_sim.channel.simulate import SimulationInterruptedError, simulate
from mvla_sim.dataset.campaign import CampaignSettings
from mvla_sim.dataset.sample import draw_sample, family_of, split_of
from mvla_sim.engine.cache import cache_url
from mvla_sim.engine.provenance import provenance
from mvla_sim.errors import MvlaWarning, OutputError, RuntimeUnfitError, reason
from mvla_sim.evaluation.ground_truth import rasterize
from mvla_sim.grid import VoxelGrid
from mvla_sim.netcdf import PACKED
from mvla_sim.progress import Advance, progress
from mvla_sim.scene.world import Scene, SceneSettings
from mvla_sim.settings import Settings

__all__ = [
    "CHANNEL_VARIABLES", "OCCUPANCY", "OPTIONAL", "SHARD_SCHEMA", "SHARD_VERSION", "TEXTS", "VARIABLES",
    "FailedSample", "Sample", "Shard",
    "data_digest", "encode", "make_one", "make_sample", "make_shard", "numbers_of", "occupancy_of", "scene_of",
    "shard_name",
]  # fmt: skip

SHARD_SCHEMA: Final = "mvla-sim dataset shard"
SHARD_VERSION: Final = 1
OCCUPANCY: Final = {"inside": 1, "contour": 2}
"""Bits of ``occupancy``: a voxel that the outline covers or meets, and one that its boundary meets (then both)."""
CHANNEL_VARIABLES: Final = (
    *Cir.VARIABLES,
    *(
        replace(item, dims=("sample", *item.dims)) if item.name in ("center", "target_extent") else item
        for item in HEADER
    ),
)
"""Variables of the channels, as in their files; of several samples one after another, or a row a sample."""
TEXTS: Final = ("outline_wkt", "metadata", "failed_error")
OPTIONAL: Final = tuple(item.name for item in CHANNEL_VARIABLES if item.optional)
"""Only where a sample has them; NaN in samples without."""
VARIABLES: Final = (
    "sample", "view_count", "occupancy", "failed_sample", *TEXTS,
    *(item.name for item in CHANNEL_VARIABLES if not item.optional),
)  # fmt: skip


class FailedSample(Settings):
    """A sample that could not be made, and why, in one line."""

    sample: NonNegativeInt
    error: str


@dataclass(frozen=True, eq=False)
class Sample:
    """One sample: a channel and the truth about its target.

    Attributes
    ----------
    cir
        The channel impulse responses; ``cir.config`` are the scene's settings.
    occupancy
        ``[ny, nx]`` uint8: bit 1 where a voxel is covered or met by the outline, bit 2 where its boundary meets it.
    grid
        The voxel grid of the occupancy, one layer.
    metadata
        Plain data: ``sample`` (its number), ``family``, ``split``, ``objects``, ``settings`` of the scene.
    """

    cir: Cir
    occupancy: NDArray[np.uint8]
    grid: VoxelGrid
    metadata: Mapping[str, Any]

    @property
    def number(self) -> int:
        """Its number in the campaign."""
        return int(self.metadata["sample"])

    @property
    def outline(self) -> Any:
        """The target's outline, (x, y) in metres."""
        return self.cir.outline

    @property
    def filled(self) -> NDArray[np.bool_]:
        """Voxels that the target covers or meets, ``[1, ny, nx]``, as the truth ``filled`` of an evaluation."""
        return np.asarray((self.occupancy & OCCUPANCY["inside"]) > 0)[None]

    @property
    def contour(self) -> NDArray[np.bool_]:
        """Voxels that the target's boundary meets, ``[1, ny, nx]``, as the truth ``contour`` of an evaluation."""
        return np.asarray((self.occupancy & OCCUPANCY["contour"]) > 0)[None]


@dataclass(frozen=True)
class Shard:
    """A finished shard, still in memory: the bytes of its file, the checksum of its data, and the samples not in it."""

    number: int
    content: bytes
    data_sha256: str
    failed: tuple[FailedSample, ...]
    seconds: float


def shard_name(number: int) -> str:
    """File name of a shard."""
    return f"shard-{number:05d}.nc"


def numbers_of(campaign: CampaignSettings, shard: int) -> range:
    """Numbers of the samples that belong to a shard, those that fail included."""
    first = shard * campaign.samples_per_shard
    return range(first, min(first + campaign.samples_per_shard, campaign.samples))


def make_shard(campaign: CampaignSettings, number: int) -> Shard:
    """Draw, trace and encode the samples of a shard; one that raises is recorded and the others go on.

    Raises
    ------
    RuntimeUnfitError, OutputError, SimulationInterruptedError
        The machine or the user ends the work; that is no fault of a sample.
    """
    numbers = numbers_of(campaign, number)
    began = time.perf_counter()
    found = []
    with _progress_hidden(shard_name(number), len(numbers)) as advance:
        for sample in numbers:
            found.append(_made_or_failed(campaign, sample))
            advance(1)
    return encode(campaign, number, found, time.perf_counter() - began)


def make_one(campaign: CampaignSettings, number: int) -> Sample | FailedSample:
    """Make one sample, or say why it could not be made; errors as :func:`make_shard`."""
    with _progress_hidden(f"sample {number}", 1):
        return _made_or_failed(campaign, number)


def _made_or_failed(campaign: CampaignSettings, number: int) -> Sample | FailedSample:
    try:
        return make_sample(campaign, number, cache=cache_url() is not None)
    except (RuntimeUnfitError, OutputError, SimulationInterruptedError):
        raise
    except Exception as error:  # noqa: BLE001 - one bad sample must not stop the others; the index says why
        return FailedSample(sample=number, error=reason(error))


@contextlib.contextmanager
def _progress_hidden(description: str, samples: int) -> Iterator[Advance]:
    """Within the block the tracer's reports go below the bar that this process shows; where there is none, nowhere."""
    nothing = io.StringIO()
    with contextlib.ExitStack() as stack:
        advance = stack.enter_context(progress(description, samples, "samples", Console(file=nothing)))
        if sys.stderr.isatty():  # of a worker beside the process that shows the build's own bar
            bar = Console(file=nothing, force_terminal=True, quiet=True)
            advance = stack.enter_context(progress(description, samples, "samples", bar))
        yield advance


def scene_of(settings: SceneSettings) -> Scene:
    """The scene of a sample; its sensor's height is what the campaign chose for all, so nothing is said of it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MvlaWarning)
        return Scene(settings, source=settings.name)


def make_sample(campaign: CampaignSettings, number: int, *, cache: bool = False) -> Sample:
    """Draw and trace one sample; ``cache`` as of ``simulate``; errors as of it and of ``draw_sample``."""
    settings = draw_sample(campaign, number)
    scene = scene_of(settings)
    stored = shapely.from_wkt(_wkt(scene.outline))  # rounding must not part the occupancy from the outline
    metadata = {
        "sample": number,
        "family": family_of(campaign, number).name,
        "split": split_of(campaign, number),
        "objects": len(settings.objects),
        "settings": settings.model_dump(mode="json"),
    }
    grid = VoxelGrid.from_settings(campaign.grid)
    return Sample(simulate(scene, cache=cache), occupancy_of(stored, grid), grid, metadata)


def occupancy_of(outline: Any, grid: VoxelGrid) -> NDArray[np.uint8]:
    """Bits of :data:`OCCUPANCY` of each voxel of a one-layer grid, ``[ny, nx]``."""
    inside = rasterize(outline, grid, "filled")[0].astype(np.uint8)
    contour = rasterize(outline, grid, "contour")[0].astype(np.uint8)
    return np.asarray(OCCUPANCY["inside"] * inside | OCCUPANCY["contour"] * contour, np.uint8)


def encode(campaign: CampaignSettings, number: int, found: Sequence[Sample | FailedSample], seconds: float) -> Shard:
    """Put the samples of a shard into the bytes of its file, with those that failed and the time all took."""
    failed = tuple(item for item in found if isinstance(item, FailedSample))
    variables = _variables(campaign, [item for item in found if isinstance(item, Sample)]) | _failures(failed)
    digest = data_digest({name: entry[1] for name, entry in variables.items()})
    dataset = xr.Dataset(variables, attrs=_attributes(campaign, number) | {
        "data_sha256": digest, "seconds": seconds,
    })  # fmt: skip
    packed = ["sample", "view_count", "occupancy", *(item.name for item in CHANNEL_VARIABLES if item.packed)]
    encoding: dict[str, dict[str, Any]] = {
        name: PACKED | {"_FillValue": None} for name in packed if name in dataset and dataset[name].size
    }
    if "occupancy" in encoding:
        encoding["occupancy"]["chunksizes"] = (1, *dataset["occupancy"].shape[1:])
    with dask.config.set(scheduler="synchronous"):  # else xarray asks a Dask worker for a lock named like the buffer
        content = bytes(dataset.to_netcdf(engine="h5netcdf", encoding=encoding))
    return Shard(number, content, digest, failed, seconds)


def data_digest(arrays: Mapping[str, Any]) -> str:
    """SHA-256, in hexadecimal, over names, types, shapes and values of a shard's variables, in order of name."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        if name in TEXTS:
            digest.update(f"{name} {json.dumps([str(text) for text in arrays[name]])}\n".encode())
            continue
        values = np.asarray(arrays[name])
        values = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        digest.update(f"{name} {values.dtype.str} {values.shape}\n".encode() + values.tobytes())
    return digest.hexdigest()


def _attributes(campaign: CampaignSettings, number: int) -> dict[str, Any]:
    return {
        "Conventions": "CF-1.11",
        "title": f"{campaign.name}: shard {number} of {campaign.shards}",
        "licence": campaign.licence,
        "schema": SHARD_SCHEMA,
        "schema_version": SHARD_VERSION,
        "shard": number,
        "campaign_sha256": campaign.digest(),
        "config": campaign.model_dump_json(),
        "provenance": json.dumps(provenance(), sort_keys=True),
    }


def _texts(values: Iterable[str]) -> NDArray[np.object_]:
    """Texts of any length, ``[n]``; the type tells xarray what they are where there is none."""
    found = list(values)
    array = np.empty(len(found), np.dtype("O", metadata={"element_type": str}))
    array[:] = found
    return array


def _wkt(outline: Any) -> str:
    """Well-known text of an outline, to a nanometre."""
    return str(shapely.to_wkt(outline, rounding_precision=9))


def _failures(failed: Sequence[FailedSample]) -> dict[str, Any]:
    errors = _texts(failure.error for failure in failed)
    return {
        "failed_sample": (
            "failure",
            np.array([failure.sample for failure in failed], np.int64),
            {"long_name": "number of a sample that could not be made"},
        ),
        "failed_error": ("failure", errors, {"long_name": "why, in one line"}),
    }


def _variables(campaign: CampaignSettings, made: Sequence[Sample]) -> dict[str, Any]:
    """Every variable as xarray takes it: dimensions, values, attributes."""
    cirs = [sample.cir for sample in made]
    nx, ny, _ = VoxelGrid.from_settings(campaign.grid).counts
    xs, ys, _ = VoxelGrid.from_settings(campaign.grid).axes()
    outlines = _texts(_wkt(sample.cir.outline) for sample in made)
    metadata = _texts(json.dumps(dict(sample.metadata), sort_keys=True) for sample in made)
    masks = {"flag_masks": np.array(list(OCCUPANCY.values()), np.uint8), "flag_meanings": " ".join(OCCUPANCY)}
    variables: dict[str, Any] = {
        "sample": ("sample", np.array([m.number for m in made], np.int64), {"long_name": "number of the sample"}),
        "view_count": (
            "sample",
            np.array([c.n_view for c in cirs], np.int64),
            {"long_name": "number of views of the sample", "sample_dimension": "view"},
        ),
        "occupancy": (
            ("sample", "y", "x"),
            np.array([m.occupancy for m in made], np.uint8).reshape(-1, ny, nx),
            {"long_name": "voxels of the target", **masks},
        ),
        "outline_wkt": ("sample", outlines, {"long_name": "outline of the target, x and y in metres"}),
        "metadata": ("sample", metadata, {"long_name": "sample, family, split, settings of the scene; JSON"}),
        "x": ("x", xs, {"long_name": "voxel centres", "units": "m"}),
        "y": ("y", ys, {"long_name": "voxel centres", "units": "m"}),
    }
    for item in CHANNEL_VARIABLES:
        parts = [item.of(cir) for cir in cirs]
        if not item.dims:
            variables[item.name] = item.entry(getattr(campaign.radio, item.field))
        elif item.dims[0] == "sample":
            variables[item.name] = item.entry(item.joined([part[None] for part in parts if part is not None]))
        elif not item.optional or any(part is not None for part in parts):
            filled = [np.full((c.n_view, 3), np.nan) if p is None else p for c, p in zip(cirs, parts, strict=True)]
            variables[item.name] = item.entry(item.joined(filled))
    return variables
