"""A polygon by its vertices."""

from __future__ import annotations

from typing import Annotated, Literal

from numpy.typing import ArrayLike
from pydantic import Field

from mvla_sim.scene.shape import Prism

__all__ = ["Polygon"]


class Polygon(Prism):
    """Any simple polygon by its vertices, in order."""

    shape: Literal["polygon"] = "polygon"
    vertices_m: Annotated[
        tuple[tuple[float, float], ...], Field(min_length=3, description="corners, x and y, in either direction")
    ]

    def corners(self) -> ArrayLike:
        """As given, in either sense of rotation."""
        return self.vertices_m
