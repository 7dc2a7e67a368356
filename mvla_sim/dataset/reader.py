"""Reading shards: one sample at a time, everything checked, nothing outside the file followed.

A shard comes from somebody else. Its links and external storage could name other files, so a file that has any is
refused; texts are plain, and nothing is ever unpickled.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
import shapely
from numpy.typing import NDArray

from mvla_sim.channel.cir import Cir
from mvla_sim.dataset.campaign import CampaignSettings
from mvla_sim.dataset.shard import (
    CHANNEL_VARIABLES,
    OCCUPANCY,
    OPTIONAL,
    SHARD_SCHEMA,
    SHARD_VERSION,
    TEXTS,
    VARIABLES,
    FailedSample,
    Sample,
    data_digest,
    numbers_of,
)
from mvla_sim.errors import DataError, MvlaError
from mvla_sim.evaluation.ground_truth import check_inside
from mvla_sim.files import existing_file
from mvla_sim.grid import VoxelGrid
from mvla_sim.netcdf import check_heaps
from mvla_sim.ragged import Rows
from mvla_sim.scene.world import SceneSettings
from mvla_sim.settings import parse

__all__ = ["ShardReader"]

_BROKEN = (
    OSError, ValueError, KeyError, RuntimeError, AttributeError, TypeError, IndexError, OverflowError, MemoryError,
    shapely.GEOSException,
)  # fmt: skip
_FILTERS: Final = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
MOST_PACKED: Final = 1100
"""How many times larger than the file a variable can be: deflate saves a factor of 1032 at most."""
LEAST_ROOM: Final = 1 << 16
"""Bytes that any file may claim to hold."""


class ShardReader:
    """An open shard, which must be that of a campaign and number; use it as a context manager, or :meth:`close` it.

    Raises
    ------
    DataError
        Missing, a link, truncated, of another schema, campaign or number, or at odds with itself.
    """

    def __init__(self, file: str | os.PathLike[str], campaign: CampaignSettings, number: int) -> None:
        self.file = Path(file)
        self.campaign = campaign
        self.number = number
        if self.file.is_symlink():
            raise DataError(f"{self.file}: is a link; a dataset's files must lie in its own directory")
        existing_file(self.file, "shard")
        check_heaps(self.file)
        with self.explained():
            self._bytes = self.file.stat().st_size
            self._handle = h5py.File(self.file, "r")
        try:
            with self.explained():
                self._check_header()
                self._load_tables()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._handle.close()

    def __enter__(self) -> ShardReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def seconds(self) -> float:
        """How long it took to make, seconds."""
        with self.explained():
            return float(self._number("seconds"))

    @property
    def provenance(self) -> dict[str, str]:
        """What it was made with."""
        with self.explained():
            return dict(json.loads(self._handle.attrs["provenance"]))

    def stored_digest(self) -> str:
        """The checksum over the data that the file itself holds."""
        return str(self._handle.attrs.get("data_sha256"))

    def digest(self) -> str:
        """The checksum over the data as they are; reads all of them."""
        with self.explained():
            names = [*VARIABLES, "x", "y", *(name for name in OPTIONAL if name in self._handle)]
            return data_digest({name: self._texts(name) if name in TEXTS else self._handle[name][()] for name in names})

    def row_of(self, number: int) -> int:
        """Index of a sample in this file."""
        row = int(np.searchsorted(self.samples, number))
        if row == self.samples.size or self.samples[row] != number:
            raise DataError(f"{self.file}: holds no sample {number}")
        return row

    def places(self, rows: NDArray[np.intp]) -> dict[str, NDArray[np.int64]]:
        """Indices of some samples, of their views and of their paths, by dimension."""
        views = self._views.elements(rows)
        return {"sample": np.asarray(rows, np.int64), "view": views, "path": self._paths.elements(views)}

    def sample(self, row: int) -> Sample:
        """Read and check the sample at an index.

        Raises
        ------
        DataError
            It is damaged or inconsistent.
        """
        views = self._views.rows(row)
        paths = slice(int(self._paths.row_start[views.start]), int(self._paths.row_start[views.stop]))
        with self.explained():
            metadata = self._metadata(row)
            occupancy = np.asarray(self._handle["occupancy"][row], np.uint8)
            if (occupancy & ~np.uint8(sum(OCCUPANCY.values()))).any():
                raise DataError(f"occupancy holds values other than sums of {list(OCCUPANCY.values())}")
            grid = VoxelGrid.from_settings(self.campaign.grid)
            return Sample(self._cir(row, views, paths, metadata), occupancy, grid, metadata)

    def metadata(self, row: int) -> dict[str, Any]:
        """The metadata of the sample at an index, and its numbers of views and paths."""
        views = self._views.rows(row)
        with self.explained():
            return self._metadata(row) | {
                "views": views.stop - views.start,
                "paths": int(self._paths.row_size[views].sum()),
                "extent_m": float(self._handle["target_extent"][row]),
            }

    def _metadata(self, row: int) -> dict[str, Any]:
        """The metadata at an index, with all that :class:`~mvla_sim.dataset.shard.Sample` promises."""
        number = int(self.samples[row])
        found = json.loads(self._handle["metadata"].asstr()[row])
        if not isinstance(found, dict) or found.get("sample") != number:
            raise DataError(f"metadata of row {row} is not that of sample {number}")
        for name, kind in (("family", str), ("split", str), ("objects", int), ("settings", dict)):
            if not isinstance(found.get(name), kind):
                raise DataError(
                    f"metadata of sample {number}: {name} is {str(found.get(name))[:40]!r}, no {kind.__name__}"
                )
        scene = parse(SceneSettings, found["settings"], f"settings of sample {number}")
        if len(scene.objects) != found["objects"]:
            raise DataError(
                f"metadata of sample {number}: objects = {found['objects']}, but the scene has another number"
            )
        return found

    def _cir(self, row: int, views: slice, paths: slice, metadata: dict[str, Any]) -> Cir:
        read = self._handle
        place: dict[str, Any] = {"path": paths, "view": views, "sample": row}
        stored = {item.name: read[item.name][place[item.dims[0]] if item.dims else ()]
                  for item in CHANNEL_VARIABLES if item.name in read}  # fmt: skip
        for name in OPTIONAL:
            if name in stored and np.isnan(stored[name]).all():
                del stored[name]
        return Cir(
            **Cir.fields_of(stored),
            outline=self._outline(row),
            plane_height_m=self.campaign.grid.middle_m()[2],
            antenna=self.campaign.radio.antenna,
            config=metadata.get("settings", {}),
            provenance=self.provenance,
        )

    def _outline(self, row: int) -> Any:
        found = shapely.from_wkt(self._handle["outline_wkt"].asstr()[row])
        check_inside(found, VoxelGrid.from_settings(self.campaign.grid))
        return found

    def _check_header(self) -> None:
        attributes = self._handle.attrs
        if (found := str(attributes.get("schema"))) != SHARD_SCHEMA:
            raise DataError(f"schema is '{found}', not '{SHARD_SCHEMA}'")
        if (version := self._number("schema_version")) != SHARD_VERSION:
            raise DataError(f"schema version {version}; this program reads version {SHARD_VERSION}")
        if (shard := self._number("shard")) != self.number:
            raise DataError(f"is shard {shard}, not {self.number}")
        if str(attributes.get("campaign_sha256")) != self.campaign.digest():
            raise DataError(f"belongs to another campaign than '{self.campaign.name}', or to other settings of it")
        for name in self._handle:
            if not isinstance(self._handle.get(name, getlink=True), h5py.HardLink):
                raise DataError(f"'{name}' is a link to elsewhere; a shard holds its own data")
            item = self._handle[name]
            if not isinstance(item, h5py.Dataset) or item.external or item.is_virtual:
                raise DataError(f"'{name}' is stored elsewhere; a shard holds its own data")
        for name in (*VARIABLES, "x", "y"):
            if name not in self._handle:
                raise DataError(f"variable '{name}' is missing")
        for name in (*VARIABLES, "x", "y", *(name for name in OPTIONAL if name in self._handle)):
            self._check_variable(name)

    def _check_variable(self, name: str) -> None:
        """Refuse a variable of another type, or one that claims to hold more than the file can."""
        item = self._handle[name]
        kind = "text" if h5py.check_string_dtype(item.dtype) is not None else item.dtype.kind
        if kind not in (("text",) if name in TEXTS else tuple("iuf")):
            raise DataError(f"'{name}' has type {item.dtype}")
        creation = item.id.get_create_plist()
        filters = [creation.get_filter(number)[0] for number in range(creation.get_nfilters())]
        if len(set(filters)) < len(filters) or not _FILTERS.issuperset(filters):
            raise DataError(f"'{name}' is packed in a way that shards are not")
        if item.size * item.dtype.itemsize > max(MOST_PACKED * self._bytes, LEAST_ROOM):
            raise DataError(f"'{name}' claims to hold {item.size} values, more than a file of {self._bytes} bytes can")

    def _load_tables(self) -> None:
        """Read what says where everything is, and check that it adds up."""
        read = self._handle
        if read["sample"].size > self.campaign.samples_per_shard:
            raise DataError(f"holds {read['sample'].size} samples; at most {self.campaign.samples_per_shard}")
        self.samples: NDArray[np.int64] = read["sample"][()].astype(np.int64)
        view_count = read["view_count"][()].astype(np.int64)
        row_size = read["row_size"][()].astype(np.int64)
        errors = self._texts("failed_error")
        self.failed = tuple(
            FailedSample(sample=int(number), error=text)
            for number, text in zip(read["failed_sample"][()], errors, strict=True)
        )
        there = sorted([*self.samples.tolist(), *(failure.sample for failure in self.failed)])
        if there != list(numbers_of(self.campaign, self.number)) or (np.diff(self.samples) <= 0).any():
            raise DataError(f"holds samples {there[:3]}… in another order or number than shard {self.number} has")
        grid = VoxelGrid.from_settings(self.campaign.grid)
        nx, ny, _ = grid.counts
        count, views, paths = self.samples.size, row_size.size, read["delay"].size
        lengths = {"sample": count, "view": views, "path": paths, "xyz": 3, "xy": 2}
        shapes: dict[str, tuple[int, ...]] = {
            "view_count": (count,), "occupancy": (count, ny, nx), "outline_wkt": (count,), "metadata": (count,),
            "x": (nx,), "y": (ny,),
            **{item.name: tuple(lengths[dim] for dim in item.dims) for item in CHANNEL_VARIABLES},
        }  # fmt: skip
        for name, shape in shapes.items():
            if name in read and read[name].shape != shape:
                raise DataError(f"{name} has shape {read[name].shape}, must be {shape}")
        for name, axis in zip("xy", grid.axes()[:2], strict=True):
            if not np.allclose(read[name][()], axis, rtol=0, atol=1e-9):
                raise DataError(f"{name} is not that of the campaign's grid")
        for name, sizes, total in (("view_count", view_count, views), ("row_size", row_size, paths)):
            if (sizes < 0).any() or int(sizes.sum()) != total:
                raise DataError(f"{name} adds up to {sizes.sum()}, the file holds {total}")
        self._views, self._paths = Rows(view_count), Rows(row_size)

    def _number(self, name: str) -> Any:
        """A number among the attributes; NetCDF knows them as arrays of one."""
        return np.ravel(self._handle.attrs[name])[0]

    def _texts(self, name: str) -> list[str]:
        """All texts of a variable; they are not packed, so more than the file's size is one text many times over."""
        found: list[str] = []
        left = self._bytes
        item = self._handle[name].asstr()
        for row in range(self._handle[name].size):
            found.append(str(item[row]))
            left -= len(found[-1])
            if left < 0:
                raise DataError(f"'{name}' claims to hold more text than a file of {self._bytes} bytes can")
        return found

    @contextlib.contextmanager
    def explained(self) -> Iterator[None]:
        """Within the block, whatever a damaged file raises becomes one line that names it."""
        try:
            yield
        except MvlaError as error:
            raise DataError(f"{self.file}: {error}") from error
        except _BROKEN as error:
            detail = " ".join(str(error).split())[:120]
            raise DataError(f"{self.file}: not a readable shard, truncated or damaged ({detail})") from error
