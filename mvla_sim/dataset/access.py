"""Opening a dataset: samples one by one, lazily, and as labelled arrays that are not loaded."""

from __future__ import annotations

import bisect
import os
from collections import OrderedDict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import xarray as xr

from mvla_sim.dataset.campaign import SPLITS, CampaignSettings
from mvla_sim.dataset.index import Index
from mvla_sim.dataset.reader import ShardReader
from mvla_sim.dataset.sample import split_of
from mvla_sim.dataset.shard import Sample
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.grid import VoxelGrid

__all__ = ["BenchmarkDataset", "Sample", "open_dataset"]

OPEN_SHARDS: Final = 8
"""Shards kept open at a time."""

Transform = Callable[[Sample], Any]


class BenchmarkDataset:
    """The samples of a dataset, or of one of its splits, in order of their numbers.

    It has ``len()`` and ``[k]``, which is all that a PyTorch ``DataLoader`` asks of a map-style dataset. It can be
    pickled and used after a fork (with a transform that is a function of a module): what is handed over holds no open
    file. Parameters are those of :func:`open_dataset`, with the index in place of the folder.
    """

    def __init__(self, index: Index, split: str | None = None, transform: Transform | None = None) -> None:
        if split is not None and split not in SPLITS:
            raise ConfigError(f"split = '{split}': there is none; allowed: {', '.join(SPLITS)}")
        self.index = index
        self.split = split
        self.transform = transform
        self.numbers: tuple[int, ...] = tuple(index.numbers(split))
        self.grid = VoxelGrid.from_settings(index.campaign.grid)
        self._open: OrderedDict[int, ShardReader] = OrderedDict()
        self._process = os.getpid()

    @property
    def campaign(self) -> CampaignSettings:
        """The settings that the dataset was made from."""
        return self.index.campaign

    def __len__(self) -> int:
        return len(self.numbers)

    def __getitem__(self, k: int) -> Any:
        """Read sample ``k`` of this split (not of the campaign), transformed where there is a transform.

        Raises
        ------
        IndexError
            There is none.
        DataError
            Its shard is missing or damaged.
        """
        try:
            number = self.numbers[k]
        except IndexError:
            raise IndexError(f"sample {k}: allowed: 0 to {len(self) - 1}") from None
        reader = self._reader(number // self.campaign.samples_per_shard)
        sample = reader.sample(reader.row_of(number))
        return sample if self.transform is None else self.transform(sample)

    def __iter__(self) -> Iterator[Any]:
        return (self[k] for k in range(len(self)))

    def by_number(self, number: int) -> Any:
        """The sample of a number of the campaign; errors as ``[k]``, DataError where this split has no such sample."""
        k = bisect.bisect_left(self.numbers, number)
        if k == len(self.numbers) or self.numbers[k] != number:
            raise DataError(f"{self.index.folder}: no sample {number} in {self.split or 'this dataset'}")
        return self[k]

    def metadata(self, k: int) -> dict[str, Any]:
        """Metadata of sample ``k`` with its numbers of views and paths and its extent; reads no path."""
        number = self.numbers[k]
        reader = self._reader(number // self.campaign.samples_per_shard)
        return reader.metadata(reader.row_of(number))

    def provenance(self, k: int) -> dict[str, str]:
        """Versions and machine that sample ``k`` was made with."""
        return self._reader(self.numbers[k] // self.campaign.samples_per_shard).provenance

    def to_xarray(self) -> xr.DataTree:
        """Labelled arrays, a node a shard as in its file, and the split of each sample; nothing is loaded.

        A node has the samples of this split alone, with their views and paths, and a shard without any is left out.
        Samples that could not be made are of no split, and in all. Close it when done.

        Raises
        ------
        DataError
            A shard is missing or damaged.
        """
        shards = sorted({number // self.campaign.samples_per_shard for number in self.numbers})
        nodes: dict[str, xr.Dataset] = {}
        for shard in shards:
            reader = self._reader(shard)  # checks the file
            rows = np.flatnonzero(np.isin(reader.samples, self.numbers))
            part = rows.size < reader.samples.size  # picked from blocks: HDF5 itself is slow at picking
            with reader.explained():
                lazy = xr.open_dataset(
                    self.index.file(shard), engine="h5netcdf", decode_cf=False, chunks={} if part else None
                )
            if part:
                lazy = lazy.isel(reader.places(rows))
            splits = [split_of(self.campaign, int(number)) for number in reader.samples[rows]]
            nodes[Path(self.index.shards[shard].name).stem] = lazy.assign_coords(split=("sample", splits))
        return xr.DataTree.from_dict(nodes, name=self.campaign.name)

    def close(self) -> None:
        """Close what is open; it is opened again when needed."""
        while self._open:
            self._open.popitem()[1].close()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": OrderedDict(), "_process": None}

    def __repr__(self) -> str:
        return f"BenchmarkDataset({self.campaign.name!r}, split={self.split!r}, {len(self)} samples)"

    def _reader(self, shard: int) -> ShardReader:
        """An open shard; the least recently used one is closed where there are too many."""
        if self._process != os.getpid():  # a fork: the handles are its parent's
            self._open, self._process = OrderedDict(), os.getpid()
        if shard not in self._open:
            while len(self._open) >= OPEN_SHARDS:
                self._open.popitem(last=False)[1].close()
            self._open[shard] = ShardReader(self.index.file(shard), self.campaign, shard)
        self._open.move_to_end(shard)
        return self._open[shard]


def open_dataset(
    folder: str | os.PathLike[str], split: str | None = None, transform: Transform | None = None
) -> BenchmarkDataset:
    """Open a dataset; shards are opened when their samples are read.

    Parameters
    ----------
    folder
        Its directory.
    split
        ``train``, ``validation`` or ``test``; None for all samples.
    transform
        Function applied to each :class:`Sample`, for example to make tensors.

    Raises
    ------
    DataError, ConfigError
        It is no dataset, its index is damaged or names files outside its directory, or there is no such split.

    Examples
    --------
    >>> import mvla_sim as mv
    >>> train = mv.open_dataset("datasets/benchmark-small", split="train")  # doctest: +SKIP
    >>> train[0].cir.n_view  # doctest: +SKIP
    72
    """
    return BenchmarkDataset(Index.load(folder), split, transform)
