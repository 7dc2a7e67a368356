"""Loading any channel file by the schema it declares."""

from __future__ import annotations

import os

from mvla_sim.channel.cir import SCHEMA as CIR_SCHEMA
from mvla_sim.channel.cir import Cir
from mvla_sim.channel.components import COMPONENT_SCHEMA, Components
from mvla_sim.channel.response import RESPONSE_SCHEMA, FrequencyResponse
from mvla_sim.errors import DataError
from mvla_sim.files import existing_file
from mvla_sim.netcdf import schema_of

__all__ = ["CHANNEL_SCHEMAS", "Channel", "load_channel"]

Channel = Cir | FrequencyResponse | Components
"""Paths, frequency responses, or ready-made components: what an image can be made from."""

_KINDS: dict[str, type[Cir] | type[FrequencyResponse] | type[Components]] = {
    CIR_SCHEMA: Cir,
    RESPONSE_SCHEMA: FrequencyResponse,
    COMPONENT_SCHEMA: Components,
}
CHANNEL_SCHEMAS = tuple(_KINDS)


def load_channel(path: str | os.PathLike[str]) -> Channel:
    """Read a channel file of any kind.

    Raises
    ------
    DataError
        Missing, damaged, or of none of the three schemas.
    """
    schema = schema_of(existing_file(path, "channel file"))
    if schema not in _KINDS:
        raise DataError(f"{path}: schema is {schema!r}; allowed: {', '.join(map(repr, _KINDS))}")
    return _KINDS[schema].load(path)
