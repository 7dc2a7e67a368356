"""Exporting a dataset to what other programs read: DeepMIMO's ``.npz`` layout, and one MATLAB file."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.io import savemat

from mvla_sim.channel.cir import INTERACTIONS, Cir
from mvla_sim.dataset.access import BenchmarkDataset
from mvla_sim.dataset.shard import Sample
from mvla_sim.errors import ConfigError, DataError, OutputError
from mvla_sim.files import atomic_output, check_writable, make_folder
from mvla_sim.progress import progress
from mvla_sim.scene.world import SceneSettings

__all__ = ["export_mat", "export_npz"]

_DIGITS: Final = {"specular": 1, "diffraction": 2, "diffuse": 3, "refraction": 4}
"""DeepMIMO's codes of interactions."""
LARGEST_MAT_BYTES: Final = 2**31 - 1
"""Of one variable in MATLAB's format 5."""
BYTES_OF_PATH: Final = 12
"""Of the largest variable along paths, the first point: three numbers in single precision."""


def export_npz(dataset: BenchmarkDataset, folder: str | os.PathLike[str]) -> list[Path]:
    """Write every sample as a scenario of DeepMIMO v4, a folder each: ``sample-000000`` and so on.

    DeepMIMO knows a transmitter set and a receiver set, and arrays of one transmitter and all receivers. So view m is
    transmitter m and receiver m of a sample; pairs of different views were never traced and are NaN. The truth is
    beside the arrays, where DeepMIMO does not look: ``truth.npz`` and ``metadata.json``.

    Parameters
    ----------
    dataset
        The samples, without a transform.
    folder
        Where the scenarios go; made if it is not there.

    Returns
    -------
    list of Path
        The scenarios.

    Raises
    ------
    OutputError
        The folder has a scenario of one of the names already, or cannot be written.
    DataError
        A sample is damaged.

    Notes
    -----
    Power is in dB of the path gain, phase in degrees with the carrier's included, delay absolute and in float64. Angles
    are azimuth and zenith, degrees; those of arrival are NaN where paths may have several interactions, as the points
    after the first are not kept. Of such paths the interaction code has each kind once, in the order of the codes.
    """
    _check_plain(dataset)
    place = make_folder(folder)
    targets = [place / f"sample-{number:06d}" for number in dataset.numbers]
    if there := [target for target in targets if os.path.lexists(target)]:
        raise OutputError(f"{there[0]}: is there already; choose another folder")
    with progress(f"exporting {dataset.campaign.name}", len(dataset), "samples") as advance:
        for target, sample in zip(targets, dataset, strict=True):
            try:
                with tempfile.TemporaryDirectory(prefix=".export-", dir=place) as temporary:
                    made = Path(temporary) / target.name
                    made.mkdir()
                    _write_scenario(sample, made)
                    made.rename(target)
            except OSError as error:
                shutil.rmtree(target, ignore_errors=True)
                raise OutputError(f"{target}: cannot be written ({error.strerror or error})") from error
            advance(1)
    return targets


def export_mat(dataset: BenchmarkDataset, file: str | os.PathLike[str]) -> Path:
    """Write all samples as one MATLAB file (format 5): ragged arrays as in the shards, complex gains, cells of text.

    Sample s owns ``view_count(s)`` consecutive views, and view v ``row_size(v)`` consecutive paths. ``occupancy`` is
    ``[ny, nx, sample]``, ``outline`` a cell of ``[n, 2]`` exterior rings in metres, NaN between several.

    Raises
    ------
    ConfigError
        The name does not end in ``.mat``, or an array is too large for the format: export a split, or read the shards.
    OutputError, DataError
        The file cannot be written, or a sample is damaged.
    """
    _check_plain(dataset)
    target = Path(file)
    if target.suffix != ".mat":
        raise ConfigError(f"{target}: the name must end in .mat")
    check_writable(target)
    if not len(dataset):
        raise DataError(f"{dataset.index.folder}: there is no sample to export")
    paths = sum(dataset.metadata(k)["paths"] for k in range(len(dataset)))
    largest = max(paths * BYTES_OF_PATH, len(dataset) * dataset.grid.size)  # first_point, occupancy
    if largest > LARGEST_MAT_BYTES:  # found out before anything large is read
        raise ConfigError(
            f"{target}: an array takes {largest / 2**30:.1f} GiB; a MATLAB 5 file holds 2 GiB an array: export one "
            "split, or read the shards with ncread"
        )
    with progress(f"exporting {dataset.campaign.name}", len(dataset), "samples") as advance:
        samples = []
        for sample in dataset:
            samples.append(sample)
            advance(1)
    with atomic_output(target) as temporary:
        savemat(temporary, _mat_variables(samples), do_compression=True, oned_as="column")
    return target


def _check_plain(dataset: BenchmarkDataset) -> None:
    if dataset.transform is not None:
        raise ConfigError("export: the dataset has a transform; open it without one")


def _mat_variables(samples: list[Sample]) -> dict[str, Any]:
    cirs = [sample.cir for sample in samples]
    outlines, texts = np.empty((2, len(samples)), object)
    outlines[:] = [_rings(sample.outline) for sample in samples]
    texts[:] = [json.dumps(dict(sample.metadata), sort_keys=True) for sample in samples]
    grid = samples[0].grid
    return {
        "sample": np.array([sample.metadata["sample"] for sample in samples], np.int64),
        "view_count": np.array([cir.n_view for cir in cirs], np.int64),
        "row_size": np.concatenate([cir.row_size for cir in cirs]),
        "position": np.concatenate([cir.views.positions_m for cir in cirs]),
        "receiver": np.concatenate([_receivers(cir) for cir in cirs]),
        "angle": np.concatenate([cir.views.angles_deg for cir in cirs]),
        "gain": np.concatenate([cir.gain for cir in cirs]),
        "delay": np.concatenate([cir.delay_s for cir in cirs]),
        "interaction": np.concatenate([cir.interaction for cir in cirs]),
        "first_point": np.concatenate([cir.first_point_m for cir in cirs]),
        "target_extent": np.array([cir.extent_m for cir in cirs]),
        "carrier_frequency": cirs[0].carrier_hz,
        "bandwidth": cirs[0].bandwidth_hz,
        "occupancy": np.stack([sample.occupancy for sample in samples], axis=-1),
        "x": grid.axes()[0],
        "y": grid.axes()[1],
        "outline": outlines,
        "metadata": texts,
    }


def _rings(outline: Any) -> NDArray[np.float64]:
    """Corners of the exterior rings ``[n, 2]``, a row of NaN between two."""
    parts: list[NDArray[np.float64]] = []
    for polygon in shapely.get_parts(outline):
        parts += [shapely.get_coordinates(polygon.exterior), np.full((1, 2), np.nan)]
    return np.concatenate(parts[:-1])


def _receivers(cir: Cir) -> NDArray[np.float64]:
    return cir.views.positions_m if cir.views.receivers_m is None else cir.views.receivers_m


def _write_scenario(sample: Sample, folder: Path) -> None:
    cir = sample.cir
    receivers = _receivers(cir)
    depth = SceneSettings.model_validate_json(json.dumps(sample.metadata["settings"])).ray_tracing.max_depth
    slots = max(1, int(cir.row_size.max()))
    for view in range(cir.n_view):
        rows = cir.rows(view)
        transmitter = cir.views.positions_m[view]
        points = cir.first_point_m[rows].astype(np.float64)
        departing = _angles(points - transmitter)
        arriving = _angles(points - receivers[view]) if depth == 1 else np.full_like(departing, np.nan)
        with np.errstate(divide="ignore"):
            power_db = 20 * np.log10(np.abs(cir.gain[rows].astype(np.complex128)))
        paths: dict[str, Any] = {
            "power": power_db,
            "phase": np.rad2deg(np.angle(cir.gain[rows].astype(np.complex128))),
            "delay": cir.delay_s[rows],
            "inter": _codes(cir.interaction[rows]),
            "inter_pos": points[:, None],
            "aod_az": departing[:, 0],
            "aod_el": departing[:, 1],
            "aoa_az": arriving[:, 0],
            "aoa_el": arriving[:, 1],
        }
        places = {"tx_pos": transmitter[None].astype(np.float64), "rx_pos": receivers.astype(np.float64)}
        for name, values in places.items():
            _save(folder, name, view, values)
        for name, values in paths.items():
            kind = np.float64 if name == "delay" else np.float32
            full = np.full((cir.n_view, slots, *values.shape[1:]), np.nan, kind)
            full[view, : len(values)] = values
            _save(folder, name, view, full)
    np.savez_compressed(folder / "truth.npz", occupancy=sample.occupancy, x=sample.grid.axes()[0],
                        y=sample.grid.axes()[1], outline=_rings(sample.outline))  # fmt: skip
    (folder / "metadata.json").write_text(json.dumps(dict(sample.metadata), sort_keys=True) + "\n", encoding="utf-8")
    (folder / "params.json").write_text(json.dumps(_params(cir, depth), indent=1) + "\n", encoding="utf-8")


def _save(folder: Path, name: str, view: int, values: NDArray[Any]) -> None:
    arrays: dict[str, Any] = {name: values}
    np.savez_compressed(folder / f"{name}_t000_tx{view:03d}_r001.npz", **arrays)


def _angles(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Azimuth and zenith of directions, ``[n, 2]`` degrees."""
    x, y, z = directions.T
    return np.asarray(np.rad2deg(np.column_stack([np.arctan2(y, x), np.arctan2(np.hypot(x, y), z)])), np.float64)


def _codes(interaction: NDArray[np.uint8]) -> NDArray[np.float64]:
    """DeepMIMO's codes of interaction bits, ``[n]``: a digit a kind."""
    codes = np.zeros(interaction.shape)
    for name, digit in _DIGITS.items():
        codes = np.where(interaction & INTERACTIONS[name], 10 * codes + digit, codes)
    return codes


def _params(cir: Cir, depth: int) -> dict[str, Any]:
    """``params.json`` of a scenario, with what DeepMIMO's own loader asks for."""

    def points(number: int, name: str, active: Iterable[bool]) -> dict[str, Any]:
        return {
            "name": name, "id_orig": number, "id": number, "is_tx": name == "tx", "is_rx": name == "rx",
            "num_points": cir.n_view, "num_active_points": sum(active), "num_ant": 1, "dual_pol": False,
            "ant_rel_positions": [[0, 0, 0]], "array_orientation": [0, 0, 0], "grid_spacing": None,
        }  # fmt: skip

    active = [bool(count) for count in cir.row_size]
    return {
        "version": "4.0.0",
        "rt_params": {
            "raytracer_name": "mvla-sim",
            "raytracer_version": cir.provenance.get("program", "unknown"),
            "frequency": cir.carrier_hz,
            "bandwidth": cir.bandwidth_hz,
            "max_path_depth": depth,
            "max_reflections": depth,
            "max_diffractions": 1,
            "max_scattering": depth,
            "max_transmissions": 0,
        },
        "txrx_sets": {"txrx_set_0": points(0, "tx", active), "txrx_set_1": points(1, "rx", active)},
        "scene": {"num_scenes": 1, "n_objects": 0, "n_vertices": 0, "n_faces": 0, "n_triangular_faces": 0},
        "materials": {},
    }
