"""What surfaces are made of, and how they scatter."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat

from mvla_sim.settings import Settings

__all__ = ["CustomMaterial", "ItuMaterial", "Material", "ScatteringPattern"]

ItuMaterial = Literal[
    "concrete", "brick", "plasterboard", "wood", "glass", "ceiling_board", "chipboard", "plywood", "marble",
    "floorboard", "metal", "very_dry_ground", "medium_dry_ground", "wet_ground",
]  # fmt: skip
"""Names of ITU-R P.2040."""


class CustomMaterial(Settings):
    """A homogeneous material by its constants; independent of frequency."""

    relative_permittivity: Annotated[float, Field(ge=1, description="real part, relative to vacuum")]
    conductivity_s_per_m: NonNegativeFloat = Field(0.0, description="in S/m")


Material = ItuMaterial | CustomMaterial


class ScatteringPattern(Settings):
    """Angular pattern of diffuse reflection (Degli-Esposti et al., IEEE TAP 55(1), 2007)."""

    kind: Literal["lambertian", "directive", "backscattering"] = "lambertian"
    alpha_r: Annotated[int, Field(ge=1, description="width of the lobe around the specular direction")] = 4
    alpha_i: Annotated[int, Field(ge=1, description="width of the lobe back to the source (backscattering)")] = 4
    lobe_ratio: Annotated[float, Field(ge=0, le=1, description="share of power in the specular lobe")] = 0.5
