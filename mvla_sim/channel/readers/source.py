"""What a reader of foreign data is, and what it hands over."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.header import Channel
from mvla_sim.kinds import Kind, Kinds

__all__ = ["READERS", "Foreign", "GivenRadio", "Reader", "note"]

READERS: Final[Kinds[Reader]] = Kinds("reader", "mvla_sim.readers", "mvla_sim.channel.readers", key=None)
"""All readers by name."""


class GivenRadio(NamedTuple):
    """What settings say of the radio, for data that do not say it; hertz, or None."""

    carrier_hz: float | None = None
    bandwidth_hz: float | None = None


@dataclass(frozen=True, eq=False)
class Foreign:
    """What a reader found: a channel's data, and what they say of views and radio.

    Attributes
    ----------
    kind
        Class of the channel.
    data
        The fields that are that class's own, by name.
    n_view
        Number of views.
    angles_deg
        Angle of each view, ``[n_view]`` degrees, None where the data do not say them.
    positions_m, receivers_m
        Positions of sensors, or of transmitters and receivers, ``[n_view, 3]`` metres; None likewise.
    carrier_hz
        Carrier, hertz; None where the data do not say it.
    facts
        What is worth knowing of the source, by key; becomes provenance.
    """

    kind: type[Channel]
    data: Mapping[str, Any]
    n_view: int
    angles_deg: NDArray[np.float64] | None = None
    positions_m: NDArray[np.float64] | None = None
    receivers_m: NDArray[np.float64] | None = None
    carrier_hz: float | None = None
    facts: Mapping[str, str] = field(default_factory=dict)


class Reader(Kind):
    """A reader of one kind of foreign data; its fields are the settings of its block in import settings."""

    kinds: ClassVar[Kinds[Any]] = READERS
    name: ClassVar[str]
    block: ClassVar[str]
    """Key of its settings; those of other packages have their name for it."""
    takes: ClassVar[str]
    """What it reads, for messages: "a folder of .s1p/.s2p files"."""
    setting_files: ClassVar[tuple[tuple[str, ...], ...]] = ()
    """Keys within its block that name files."""

    @classmethod
    def recognises(cls, source: Path) -> bool:
        """Whether an existing file or folder is of its kind, by name or by what a folder holds."""
        raise NotImplementedError

    def read(self, source: Path, radio: GivenRadio) -> Foreign:
        """Read a source; ``radio`` says what the data may not.

        Raises
        ------
        ConfigError, DataError
            One line that names the file or setting, its value and what is allowed.
        """
        raise NotImplementedError


def note(text: str) -> None:
    """Say in one line what was assumed of a source, or left out of it."""
    logging.getLogger("mvla_sim").warning("mvla: note: %s", text)
