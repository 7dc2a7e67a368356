"""Rows of different lengths stored one after another: paths, components or peaks, view after view."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mvla_sim.errors import DataError

__all__ = ["Ragged", "Rows"]


class Ragged:
    """Base of value objects that hold rows of different lengths in flat arrays, as CF's contiguous ragged arrays do.

    Attributes
    ----------
    row_size
        Length of each row, ``[n_row]`` int64, at least 0; a field of the subclass.
    """

    if TYPE_CHECKING:

        @property
        def row_size(self) -> NDArray[np.int64]: ...  # noqa: D102

    @cached_property
    def row_start(self) -> NDArray[np.int64]:
        """Index of each row's first element and, last, the number of elements, ``[n_row + 1]``."""
        return np.concatenate([[0], np.cumsum(self.row_size)]).astype(np.int64)

    @cached_property
    def row_index(self) -> NDArray[np.int64]:
        """Row of each element, ``[n_element]``."""
        return np.repeat(np.arange(self.row_size.size, dtype=np.int64), self.row_size)

    def rows(self, row: int) -> slice:
        """Slice of the elements of one row."""
        return slice(int(self.row_start[row]), int(self.row_start[row + 1]))

    def elements(self, rows: NDArray[np.intp]) -> NDArray[np.int64]:
        """Indices of the elements of some rows, one row after the other in the order given."""
        parts = [np.arange(self.row_start[row], self.row_start[row + 1]) for row in rows]
        return np.concatenate(parts) if parts else np.zeros(0, np.int64)

    def check_rows(self, what: str, n_row: int, n_element: int) -> None:
        """Refuse rows that are not as many as there are views, or do not add up to the elements there are.

        Raises
        ------
        DataError
            The message begins with ``what``.
        """
        size = self.row_size
        if size.shape != (n_row,):
            raise DataError(f"{what}: row_size has {size.size} entries for {n_row} views")
        if (size < 0).any() or (size > n_element).any() or size.sum() != n_element:
            raise DataError(
                f"{what}: row_size adds up to {size.sum()}, and there are {n_element}; it must be 0 or more"
            )


@dataclass(frozen=True, eq=False)
class Rows(Ragged):
    """Rows alone, where the elements are elsewhere, as in an open file."""

    row_size: NDArray[np.int64]
