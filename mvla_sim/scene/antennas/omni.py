"""An isotropic antenna."""

from __future__ import annotations

from typing import ClassVar, Literal

from mvla_sim.scene.antenna import Antenna

__all__ = ["Omni"]


class Omni(Antenna):
    """An isotropic antenna: 0 dBi in every direction."""

    directional: ClassVar[bool] = False

    kind: Literal["omni"] = "omni"

    def pattern(self) -> None:
        """None: it has no direction."""
