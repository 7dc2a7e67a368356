"""Loading any channel file by the schema it declares."""

from __future__ import annotations

import os

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.components import Components
from mvla_sim.channel.header import Channel
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.errors import DataError
from mvla_sim.netcdf import read_netcdf

__all__ = ["CHANNEL_SCHEMAS", "Channel", "load_channel"]

_KINDS: dict[str, type[Channel]] = {kind.SCHEMA: kind for kind in (Cir, FrequencyResponse, Components)}
CHANNEL_SCHEMAS = tuple(_KINDS)


def load_channel(path: str | os.PathLike[str]) -> Channel:
    """Read a channel file of any kind.

    Raises
    ------
    DataError
        Missing, damaged, or of none of the three schemas.
    """
    dataset = read_netcdf(path, "channel file")
    kind = _KINDS.get(str(dataset.attrs.get("schema")))
    if kind is None:
        allowed = ", ".join(map(repr, _KINDS))
        raise DataError(f"{os.fspath(path)}: schema is {dataset.attrs.get('schema')!r}; allowed: {allowed}")
    return kind.from_dataset(dataset, path)
