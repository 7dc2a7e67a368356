"""Pairs of transmitter and receiver: what is no such thing is refused, and choosing among them loses nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mvla_sim.channel.readers.pairs import PairPaths, PairReader, drop_line_of_sight, join_pairs, select_pairs
from mvla_sim.errors import ConfigError, DataError

ARRAYS = ("transmitters_m", "receivers_m", "row_size", "gain", "delay_s", "interaction", "first_point_m")


def random_paths(seed, n_pair, near=0.5, carrier_hz=36e9):
    """Pairs with up to four paths; about ``near`` of them have transmitter and receiver 1 cm apart."""
    rng = np.random.default_rng(seed)
    row_size = rng.integers(0, 5, n_pair)
    n = int(row_size.sum())
    transmitters = rng.normal(size=(n_pair, 3))
    apart = np.where(rng.random((n_pair, 1)) < near, 0.01, 3.0)
    interaction = rng.integers(0, 16, n).astype(np.uint8)
    first_point = rng.normal(size=(n, 3)).astype(np.float32)
    first_point[interaction == 0] = np.nan
    delay = np.concatenate([[], *(np.sort(rng.random(size)) * 1e-7 for size in row_size)])
    return PairPaths(
        transmitters_m=transmitters,
        receivers_m=transmitters + apart * [1.0, 0, 0],
        row_size=row_size.astype(np.int64),
        gain=rng.normal(size=n) + 1j * rng.normal(size=n),
        delay_s=delay,
        interaction=interaction,
        first_point_m=first_point,
        carrier_hz=carrier_hz,
        source={"format": "test"},
    )


def pair(paths, index):
    """What one pair consists of, as bytes."""
    rows = paths.row_index == index
    each = [getattr(paths, name)[rows].tobytes() for name in ("gain", "delay_s", "interaction", "first_point_m")]
    return (paths.transmitters_m[index].tobytes(), paths.receivers_m[index].tobytes(), *each)


def pairs(paths):
    return [pair(paths, index) for index in range(paths.n_pair)]


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 8))
def test_selection_keeps_pairs_whole_and_in_order(seed, n_pair):
    paths = random_paths(seed, n_pair)
    near = np.linalg.norm(paths.transmitters_m - paths.receivers_m, axis=1) < 0.1
    assert pairs(select_pairs(paths, "all", 0.1)) == pairs(paths)
    kept = [one for one, is_near in zip(pairs(paths), near, strict=True) if is_near]
    assert pairs(select_pairs(paths, "auto", 0.1)) == (kept or pairs(paths))
    if kept:
        chosen = select_pairs(paths, "co-located", 0.1)
        assert pairs(chosen) == kept
        assert chosen.source == {
            "format": "test",
            "pairs": f"the {len(kept)} of {n_pair} that are co-located within 0.1 m",
        }
    else:
        with pytest.raises(DataError, match=r"within 0\.1 m of each other; the closest are 3 m apart"):
            select_pairs(paths, "co-located", 0.1)


def test_the_tolerance_itself_is_near_enough():
    paths = random_paths(0, 3, near=0)
    exact = replace(paths, transmitters_m=np.zeros((3, 3)), receivers_m=np.eye(3) * [1, 2, 3])
    assert select_pairs(exact, "co-located", 2.0).n_pair == 2
    assert select_pairs(exact, "co-located", 1.0).n_pair == 1


def test_pairs_can_only_be_chosen_by_known_names_and_finite_tolerances():
    with pytest.raises(ConfigError, match="which = 'near': should be 'co-located', 'all' or 'auto'"):
        PairReader(which="near")
    for tolerance in (-1.0, float("nan"), float("inf")):
        with pytest.raises(ConfigError, match="tolerance_m"):
            PairReader(tolerance_m=tolerance)


def test_no_pair_at_all_is_none_that_is_co_located():
    empty = select_pairs(random_paths(0, 0), "auto", 1.0)
    assert (empty.n_pair, empty.gain.size) == (0, 0)
    with pytest.raises(DataError, match="there is no pair at all"):
        select_pairs(empty, "co-located", 1.0)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(0, 8))
def test_dropping_direct_paths_drops_nothing_else(seed, n_pair):
    paths = random_paths(seed, n_pair)
    rest = drop_line_of_sight(paths)
    keep = paths.interaction != 0
    assert rest.interaction.all()
    assert rest.n_pair == n_pair
    np.testing.assert_array_equal(rest.row_index, paths.row_index[keep])
    for name in ("gain", "delay_s", "interaction", "first_point_m"):
        np.testing.assert_array_equal(getattr(rest, name), getattr(paths, name)[keep])
    assert rest.source["direct_paths_dropped"] == str(np.count_nonzero(~keep))


def test_joined_pairs_are_those_of_the_parts():
    parts = [random_paths(seed, 4) for seed in range(3)]
    joined = join_pairs(parts, {"files": "3"})
    assert pairs(joined) == [one for part in parts for one in pairs(part)]
    assert (joined.carrier_hz, joined.source) == (36e9, {"files": "3"})


def test_parts_of_different_carriers_and_no_parts_are_refused():
    with pytest.raises(DataError, match=r"36000000000\.0 and None Hz"):
        join_pairs([random_paths(0, 2), random_paths(0, 2, carrier_hz=None)], {})
    with pytest.raises(DataError, match="there is no pair"):
        join_pairs([], {})


def poisoned(name, value):
    """A change of one entry of an array."""

    def change(paths):
        values = getattr(paths, name).copy()
        values.flat[0] = value
        return {name: values}

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (poisoned("transmitters_m", np.nan), "transmitters_m holds NaN"),
        (poisoned("receivers_m", 1e10), "receivers_m holds NaN or values beyond"),
        (poisoned("gain", np.nan), "gain is NaN or above 200 dB"),
        (poisoned("gain", complex(0, np.inf)), "gain is NaN or above 200 dB"),
        (poisoned("gain", 1e308 * (1 + 1j)), "gain is NaN or above 200 dB"),
        (poisoned("delay_s", -1e-9), "delay -1e-09 s"),
        (poisoned("delay_s", np.nan), "delay nan s"),
        (poisoned("delay_s", 2.0), "delay 2 s"),
        (poisoned("delay_s", 0.5), "rising delay"),
        (poisoned("interaction", 16), "interaction 16 has bits other"),
        (poisoned("first_point_m", np.inf), "first_point_m holds values beyond"),
        (poisoned("first_point_m", np.nan), "NaN in one coordinate only"),
        (poisoned("row_size", 9), "row_size adds up to"),
        (poisoned("row_size", -1), "row_size adds up to"),
        (lambda paths: {"row_size": np.full(6, 2**62)}, "row_size adds up to"),
        (lambda paths: {"gain": paths.gain[1:]}, r"delay_s has shape \(\d+,\), must be"),
        (lambda paths: {"receivers_m": paths.receivers_m[:, :2]}, r"receivers_m has shape \(6, 2\), must be \(6, 3\)"),
        (lambda paths: {"carrier_hz": 0.0}, "carrier 0 Hz"),
        (lambda paths: {"carrier_hz": float("inf")}, "carrier inf Hz"),
    ],
)
def test_what_cannot_be_is_refused(change, message):
    paths = random_paths(4, 6)
    assert paths.row_size[0] > 1
    assert paths.interaction[0] > 0
    with pytest.raises(DataError, match=message):
        replace(paths, **change(paths))
