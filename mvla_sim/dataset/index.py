"""The index of a dataset: its campaign, its shards with checksums, its splits; one JSON file, checked when read."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from pydantic import Field, NonNegativeFloat, NonNegativeInt, field_validator

from mvla_sim.dataset.campaign import SPLITS, CampaignSettings
from mvla_sim.dataset.sample import splits_of
from mvla_sim.dataset.shard import FailedSample, numbers_of, shard_name
from mvla_sim.engine.provenance import provenance
from mvla_sim.errors import DataError
from mvla_sim.files import as_path, atomic_output, existing_file
from mvla_sim.settings import Settings, parse

__all__ = ["INDEX", "INDEX_SCHEMA", "INDEX_VERSION", "Index", "ShardEntry", "file_sha256"]

INDEX: Final = "index.json"
INDEX_SCHEMA: Final = "mvla-sim dataset"
INDEX_VERSION: Final = 1
MOST_BYTES: Final = 1 << 30
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class ShardEntry(Settings):
    """One shard."""

    number: NonNegativeInt
    name: str
    bytes: NonNegativeInt
    sha256: Sha256 = Field(description="of the file")
    data_sha256: Sha256 = Field(description="of its data alone, whenever they were made")
    samples: NonNegativeInt = Field(description="how many it holds")
    failed: tuple[FailedSample, ...] = ()
    seconds: NonNegativeFloat = 0.0

    @field_validator("name")
    @classmethod
    def _check_name(cls, name: str) -> str:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*\.nc", name):
            raise ValueError("must be the plain name of a .nc file in the dataset's own directory")
        return name


class _Content(Settings):
    """The file as it is."""

    schema_name: str = Field(alias="schema")
    schema_version: int
    campaign: CampaignSettings
    shards: tuple[ShardEntry, ...]
    splits: dict[str, tuple[int, ...]]
    provenance: dict[str, str | None] = Field(description="the text 'none' is read as no text")


@dataclass(frozen=True)
class Index:
    """What a dataset holds: its directory, the settings it was made from, and its shards."""

    folder: Path
    campaign: CampaignSettings
    shards: Mapping[int, ShardEntry]  # by number; some may be missing while a build is at work

    @property
    def complete(self) -> bool:
        """Whether every shard is there."""
        return len(self.shards) == self.campaign.shards

    @property
    def failed(self) -> tuple[FailedSample, ...]:
        """Samples that could not be made, by number."""
        return tuple(failure for number in sorted(self.shards) for failure in self.shards[number].failed)

    def numbers(self, split: str | None = None) -> list[int]:
        """Numbers of the samples that are there, rising; of one split or all."""
        failed = {failure.sample for failure in self.failed}
        there = [k for shard in sorted(self.shards) for k in numbers_of(self.campaign, shard) if k not in failed]
        if split is None:
            return there
        wanted = set(splits_of(self.campaign)[split].tolist())
        return [k for k in there if k in wanted]

    def file(self, shard: int) -> Path:
        """Path of a shard's file; raises DataError where it is a link."""
        file = self.folder / self.shards[shard].name
        if file.is_symlink():
            raise DataError(f"{file}: is a link; a dataset's files must lie in its own directory")
        return file

    def save(self) -> None:
        """Write the index under a temporary name and rename it.

        Raises
        ------
        OutputError
            It cannot be written.
        """
        content = _Content(
            schema=INDEX_SCHEMA,
            schema_version=INDEX_VERSION,
            campaign=self.campaign,
            shards=tuple(self.shards[number] for number in sorted(self.shards)),
            splits={name: tuple(self.numbers(name)) for name in SPLITS},
            provenance=provenance(),
        )
        with atomic_output(self.folder / INDEX) as temporary:
            temporary.write_text(json.dumps(content.model_dump(mode="json", by_alias=True)) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> Index:
        """Read and check the index of a directory; shards are not opened.

        Raises
        ------
        DataError
            There is none, it is damaged or of another schema, or it names files outside the directory.
        ConfigError
            A setting in it is not allowed.
        """
        place = as_path(folder)
        if not place.is_dir():
            raise DataError(f"{place}: no such dataset; a dataset is a directory")
        file = place / INDEX
        if file.is_symlink():
            raise DataError(f"{file}: is a link; a dataset's files must lie in its own directory")
        existing_file(file, "dataset index")
        if file.stat().st_size > MOST_BYTES:
            raise DataError(f"{file}: is larger than {MOST_BYTES >> 30} GiB; this is no index")
        try:
            data = json.loads(file.read_bytes())
        except (ValueError, RecursionError) as error:
            raise DataError(f"{file}: is not readable JSON ({' '.join(str(error).split())[:120]})") from error
        if not isinstance(data, dict) or data.get("schema") != INDEX_SCHEMA:
            found = data.get("schema") if isinstance(data, dict) else None
            raise DataError(f"{file}: schema is {found!r}, not {INDEX_SCHEMA!r}")
        if data.get("schema_version") != INDEX_VERSION:
            raise DataError(
                f"{file}: schema version {data.get('schema_version')!r}; this program reads version {INDEX_VERSION}"
            )
        content = parse(_Content, data, str(file))
        index = cls(place, content.campaign, {entry.number: entry for entry in content.shards})
        index._check(content, file)
        return index

    def _check(self, content: _Content, file: Path) -> None:
        if len(self.shards) < len(content.shards):
            raise DataError(f"{file}: shards: a number is used twice")
        for number, entry in self.shards.items():
            if number >= self.campaign.shards or entry.name != shard_name(number):
                raise DataError(f"{file}: shards: '{entry.name}' with number {number} is no shard of this campaign")
            numbers = numbers_of(self.campaign, number)
            failed = {failure.sample for failure in entry.failed}
            if not failed <= set(numbers) or entry.samples + len(failed) != len(numbers):
                raise DataError(f"{file}: {entry.name}: {entry.samples} samples and {len(failed)} failed ones do not "
                                f"make the {len(numbers)} of this shard")  # fmt: skip
        check_splits(content.splits, self, file)


def check_splits(splits: Mapping[str, Iterable[int]], index: Index, file: Path) -> None:
    """Refuse splits that overlap, or are not those of the campaign."""
    if set(splits) != set(SPLITS):
        raise DataError(f"{file}: splits are {', '.join(splits) or 'none'}; must be {', '.join(SPLITS)}")
    seen: dict[int, str] = {}
    for name, numbers in splits.items():
        for k in numbers:
            if k in seen:
                raise DataError(f"{file}: splits: sample {k} is in {seen[k]} and in {name}")
            seen[k] = name
    for name in SPLITS:
        if list(splits[name]) != index.numbers(name):
            raise DataError(f"{file}: splits.{name} is not the {name} split of the samples that are there")


def file_sha256(file: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with file.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()
