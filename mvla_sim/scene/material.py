"""What surfaces are made of, and how they scatter."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field, NonNegativeFloat

from mvla_sim.settings import Settings

__all__ = ["ITU_CONSTANTS", "CustomMaterial", "ItuMaterial", "Material", "ScatteringPattern"]

ItuMaterial = Literal[
    "concrete", "brick", "plasterboard", "wood", "glass", "ceiling_board", "chipboard", "plywood", "marble",
    "floorboard", "metal", "very_dry_ground", "medium_dry_ground", "wet_ground",
]  # fmt: skip
"""Names of ITU-R P.2040."""

ITU_CONSTANTS: Final[dict[ItuMaterial, tuple[tuple[float, ...], ...]]] = {
    "concrete": ((1, 100, 5.24, 0, 0.0462, 0.7822), (110, 330, 5.17, 0, 0.0145, 1.0900)),
    "brick": ((1, 40, 3.91, 0, 0.0238, 0.16), (110, 330, 4.15, 0, 0.0006, 1.5712)),
    "plasterboard": (
        (1, 100, 2.73, 0, 0.0085, 0.9395), (110, 330, 2.56, 0, 0.0001, 1.7799), (100, 400, 2.65, 0, 0.0002, 1.598),
    ),
    "wood": (
        (0.001, 100, 1.99, 0, 0.0047, 1.0718), (110, 330, 1.82, 0, 0.0040, 1.0761),
        (100, 400, 2.1183, 0, 0.0055, 1.1113),
    ),
    "glass": (
        (0.1, 100, 6.31, 0, 0.0036, 1.3394), (220, 450, 5.79, 0, 0.0004, 1.658), (100, 400, 6.5767, 0, 0.0012, 1.4697),
    ),
    "ceiling_board": (
        (1, 100, 1.48, 0, 0.0011, 1.0750), (220, 450, 1.52, 0, 0.0029, 1.029), (100, 400, 1.2567, 0, 0.00013, 1.454),
    ),
    "chipboard": ((1, 100, 2.58, 0, 0.0217, 0.7800), (100, 200, 2.16, 0, 0.0023, 1.359)),
    "plywood": ((1, 40, 2.71, 0, 0.33, 0), (110, 330, 1.94, 0, 0.0067, 0.9982), (100, 400, 2.17, 0, 0.0063, 1.045)),
    "marble": (
        (1, 60, 7.074, 0, 0.0055, 0.9262), (110, 330, 7.94, 0, 0.0001, 1.7330), (100, 400, 8.62, 0, 0.0027, 1.15),
    ),
    "floorboard": (
        (50, 100, 3.66, 0, 0.0044, 1.3515), (220, 300, 5.27, 0, 2.22e-17, 7.3413), (300, 400, 5.27, 0, 0.0003, 2.0298),
        (400, 450, 5.27, 0, 49.8726, 0), (100, 400, 3.1575, 0, 0.001675, 1.32775),
    ),
    "metal": ((1, 100, 1, 0, 1e7, 0),),
    "very_dry_ground": ((1, 10, 3, 0, 0.00015, 2.52),),
    "medium_dry_ground": ((1, 10, 15, -0.1, 0.035, 1.63),),
    "wet_ground": ((1, 10, 30, -0.4, 0.15, 1.30),),
}  # fmt: skip
"""Table 3 of ITU-R P.2040-4: lowest and highest f in GHz, and a, b, c, d of ε_r = a·f^b and σ = c·f^d in S/m."""


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
