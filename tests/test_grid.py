"""The grid of a settings block: how many voxels, and where their edges and centres lie."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mvla_sim.errors import ConfigError
from mvla_sim.grid import GridSettings, VoxelGrid

SIZES = st.floats(0.5, 20.0)


def grid_of(**settings):
    return VoxelGrid.from_settings(GridSettings(**settings))


@pytest.mark.parametrize(
    ("align", "counts"), [(None, (200, 201, 3)), ("edges", (200, 202, 4)), ("centers", (201, 201, 3))]
)
def test_counts_are_rounded_up_to_the_parity_asked_for(align, counts):
    assert grid_of(size_m=(10.0, 10.05, 0.15), spacing_m=0.05, align=align).counts == counts


@given(size=st.tuples(SIZES, SIZES, SIZES), spacing=st.sampled_from([0.02, 0.05, 0.1, 0.3]))
def test_edges_or_centres_lie_on_multiples_of_the_spacing(size, spacing):
    free = np.array(grid_of(size_m=size, spacing_m=spacing).counts)
    center = (spacing, -2 * spacing, 5 * spacing)
    for align, shift in (("edges", 0.5), ("centers", 0.0)):
        grid = grid_of(size_m=size, spacing_m=spacing, center_m=center, align=align)
        assert set(np.array(grid.counts) - free) <= {0, 1}
        for axis in grid.axes():
            np.testing.assert_allclose((axis / spacing + shift) % 1.0 % 0.999999, 0.0, atol=2e-6)  # 0 or just below 1
    assert grid.center_m == center


@pytest.mark.parametrize("align", [None, "edges", "centers"])
def test_one_layer_stays_one_layer_at_the_centres_height(align):
    grid = grid_of(center_m=(0.0, 0.0, 1.23), align=align)
    assert grid.counts[2] == 1
    assert grid.axes()[2].tolist() == [1.23]


def test_without_alignment_the_grid_is_as_the_size_gives():
    assert grid_of().counts == (200, 200, 1)
    assert grid_of(size_m=(10.05, 9.99, 0.0)).counts == (201, 200, 1)


def test_unknown_alignments_are_refused():
    with pytest.raises(ConfigError, match="align = 'corners'") as error:
        GridSettings(align="corners")
    assert "\n" not in str(error.value)
