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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import dask
import numpy as np
import shapely
import xarray as xr
from numpy.typing import NDArray
from rich.console import Console

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.header import HEADER
from mvla_sim.channel.simulate import SimulationInterruptedError, simulate
from mvla_sim.dataset.campaign import CampaignSettings
from mvla_sim.dataset.sample import draw_sample, family_of, split_of
from mvla_sim.engine.cache import cache_url
from mvla_sim.engine.provenance import provenance
from mvla_sim.errors import OutputError, RuntimeUnfitError, reason
from mvla_sim.evaluation.ground_truth import rasterize
from mvla_sim.grid import VoxelGrid
from mvla_sim.netcdf import PACKED
from mvla_sim.progress import Advance, progress
from mvla_sim.scene.world import Scene

__all__ = [
    "CHANNEL_VARIABLES", "OCCUPANCY", "OPTIONAL", "SHARD_SCHEMA", "SHARD_VERSION", "TEXTS", "VARIABLES", "Failure",
    "Made", "Shard", "ShardTask",
    "data_digest", "encode", "make_one", "make_sample", "make_shard", "numbers_of", "occupancy_of", "shard_name",
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
    "sample",
    "view_count",
    "occupancy",
    "failed_sample",
    *TEXTS,
    *(item.name for item in CHANNEL_VARIABLES if not item.optional),
)


@dataclass(frozen=True)
class ShardTask:
    """One shard to make; a value that any process or machine can work on."""

    campaign: CampaignSettings
    number: int


@dataclass(frozen=True)
class Failure:
    """A sample that could not be made, and why, in one line."""

    sample: int
    error: str


@dataclass(frozen=True, eq=False)
class Made:
    """A sample ready to be written.

    Attributes
    ----------
    number
        Number of the sample in its campaign.
    cir
        Its channel, with outline and settings.
    occupancy
        Bits of :data:`OCCUPANCY`, ``[ny, nx]`` uint8.
    metadata
        Plain data: sample, family, split, number of objects, the scene's settings.
    """

    number: int
    cir: Cir
    occupancy: NDArray[np.uint8]
    metadata: Mapping[str, Any]


@dataclass(frozen=True)
class Shard:
    """A finished shard, still in memory.

    Attributes
    ----------
    number
        Number of the shard.
    content
        The bytes of its file.
    data_sha256
        Checksum over its data.
    failed
        Samples that are not in it.
    seconds
        How long it took.
    """

    number: int
    content: bytes
    data_sha256: str
    failed: tuple[Failure, ...]
    seconds: float


def shard_name(number: int) -> str:
    """File name of a shard."""
    return f"shard-{number:05d}.nc"


def numbers_of(campaign: CampaignSettings, shard: int) -> range:
    """Numbers of the samples that belong to a shard, those that fail included."""
    first = shard * campaign.samples_per_shard
    return range(first, min(first + campaign.samples_per_shard, campaign.samples))


def make_shard(task: ShardTask) -> Shard:
    """Draw, trace and encode the samples of a shard; one that raises is recorded and the others go on.

    Raises
    ------
    RuntimeUnfitError, OutputError, SimulationInterruptedError
        The machine or the user ends the work; that is no fault of a sample.
    """
    campaign = task.campaign
    numbers = numbers_of(campaign, task.number)
    began = time.perf_counter()
    found: list[Made | Failure] = []
    with _progress_hidden(shard_name(task.number), len(numbers)) as advance:
        for number in numbers:
            found.append(_made_or_failed(campaign, number))
            advance(1)
    made = [item for item in found if isinstance(item, Made)]
    failed = [item for item in found if isinstance(item, Failure)]
    return encode(campaign, task.number, made, failed, time.perf_counter() - began)


def make_one(campaign: CampaignSettings, number: int) -> Made | Failure:
    """Make one sample, or say why it could not be made; errors as :func:`make_shard`."""
    with _progress_hidden(f"sample {number}", 1):
        return _made_or_failed(campaign, number)


def _made_or_failed(campaign: CampaignSettings, number: int) -> Made | Failure:
    try:
        return make_sample(campaign, number, cache=cache_url() is not None)
    except (RuntimeUnfitError, OutputError, SimulationInterruptedError):
        raise
    except Exception as error:  # noqa: BLE001 - one bad sample must not stop the others; the index says why
        return Failure(number, reason(error))


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


def make_sample(campaign: CampaignSettings, number: int, *, cache: bool = False) -> Made:
    """Draw and trace one sample; errors as :func:`~mvla_sim.dataset.sample.draw_sample` and ``simulate``.

    Parameters
    ----------
    campaign
        The campaign.
    number
        Number of the sample.
    cache
        Take its channel from the cache of CIRs where it is there, and leave it there; see ``simulate``.
    """
    settings = draw_sample(campaign, number)
    scene = Scene(settings, source=settings.name)
    stored = shapely.from_wkt(_wkt(scene.outline))  # rounding must not part the occupancy from the outline
    metadata = {
        "sample": number,
        "family": family_of(campaign, number).name,
        "split": split_of(campaign, number),
        "objects": len(settings.objects),
        "settings": settings.model_dump(mode="json"),
    }
    occupancy = occupancy_of(stored, VoxelGrid.from_settings(campaign.grid))
    return Made(number, simulate(scene, cache=cache), occupancy, metadata)


def occupancy_of(outline: Any, grid: VoxelGrid) -> NDArray[np.uint8]:
    """Bits of :data:`OCCUPANCY` of each voxel of a one-layer grid, ``[ny, nx]``."""
    inside = rasterize(outline, grid, "filled")[0].astype(np.uint8)
    contour = rasterize(outline, grid, "contour")[0].astype(np.uint8)
    return np.asarray(OCCUPANCY["inside"] * inside | OCCUPANCY["contour"] * contour, np.uint8)


def encode(
    campaign: CampaignSettings, number: int, made: Sequence[Made], failed: Sequence[Failure], seconds: float
) -> Shard:
    """Put samples into the bytes of a shard file.

    Parameters
    ----------
    campaign
        The campaign, which the file carries.
    number
        Number of the shard.
    made, failed
        Its samples, and those that it does without.
    seconds
        How long they took; kept as an attribute for estimates.
    """
    variables = _variables(campaign, made) | _failures(failed)
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
    return Shard(number, content, digest, tuple(failed), seconds)


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


def _failures(failed: Sequence[Failure]) -> dict[str, Any]:
    errors = _texts(failure.error for failure in failed)
    return {
        "failed_sample": (
            "failure",
            np.array([failure.sample for failure in failed], np.int64),
            {"long_name": "number of a sample that could not be made"},
        ),
        "failed_error": ("failure", errors, {"long_name": "why, in one line"}),
    }


def _variables(campaign: CampaignSettings, made: Sequence[Made]) -> dict[str, Any]:
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
