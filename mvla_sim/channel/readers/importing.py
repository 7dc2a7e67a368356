"""From foreign data to a channel dataset: the reader of the kind, then positions, antennas and provenance."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvla_sim.channel.cir import Cir
from mvla_sim.channel.components import Components
from mvla_sim.channel.loading import Channel
from mvla_sim.channel.readers.arrays import ArrayData, read_responses
from mvla_sim.channel.readers.component_tables import read_components
from mvla_sim.channel.readers.deepmimo import read_deepmimo
from mvla_sim.channel.readers.import_settings import GeometrySettings, ImportSettings
from mvla_sim.channel.readers.insite import read_p2m
from mvla_sim.channel.readers.pairs import PairPaths, drop_line_of_sight, join_pairs, select_pairs
from mvla_sim.channel.readers.touchstone import missing_angles, read_folder, read_touchstone
from mvla_sim.channel.references import calibrate, subtract_background
from mvla_sim.channel.response import FrequencyResponse
from mvla_sim.engine.provenance import provenance
from mvla_sim.errors import ConfigError, DataError
from mvla_sim.scene.columns import PLACE, RECEIVER, read_columns
from mvla_sim.scene.pointing import pointed, side_by_side
from mvla_sim.scene.trajectories.positions import views_of_columns
from mvla_sim.scene.trajectories.turntable import on_turntable
from mvla_sim.scene.trajectory import views_on_circle
from mvla_sim.scene.views import Views

__all__ = ["import_channel", "source_kind"]

_ARRAYS = (".mat", ".npz", ".h5", ".hdf5", ".nc")


@dataclass(frozen=True, eq=False)
class _Place:
    """What data say about where they were measured: angles ``[n_view]``, or positions and receivers ``[n_view, 3]``."""

    angles_deg: NDArray[np.float64] | None = None
    positions_m: NDArray[np.float64] | None = None
    receivers_m: NDArray[np.float64] | None = None


def import_channel(settings: ImportSettings) -> Channel:
    """Read foreign data into a channel dataset.

    Parameters
    ----------
    settings
        What to read and how; see :func:`~mvla_sim.channel.readers.import_settings.import_settings`.

    Returns
    -------
    Cir, FrequencyResponse or Components
        Paths of ray tracers, responses of analysers, components that were detected elsewhere.

    Raises
    ------
    ConfigError, DataError
        One line that names the file or setting, its value and what is allowed.
    """
    kind = settings.kind or source_kind(settings)
    return _IMPORTERS[kind](settings, kind)


def source_kind(settings: ImportSettings) -> str:
    """Tell from a source's name, or from what a folder holds, what it is.

    Raises
    ------
    DataError
        It is none of what can be imported.
    """
    source = Path(settings.source)
    if not source.exists():
        raise DataError(f"{source}: no such file or folder")
    if source.is_dir():
        if (source / "params.json").exists():
            return "deepmimo"
        if any(source.glob("*.p2m")):
            return "insite"
        return "touchstone"
    suffix = source.suffix.lower()
    if suffix in (".s1p", ".s2p"):
        raise DataError(f"{source}: is one sweep; give the folder that holds a file a view")
    kinds = {".csv": "components", ".p2m": "insite", **dict.fromkeys(_ARRAYS, "arrays")}
    if suffix not in kinds:
        raise DataError(
            f"{source}: unknown kind of source; allowed: a folder of .s1p/.s2p files, a DeepMIMO folder with "
            f"params.json, {', '.join(sorted(kinds))}; or say kind ="
        )
    return kinds[suffix]


def _touchstone(settings: ImportSettings, kind: str) -> FrequencyResponse:
    sweeps, folder = settings.sweeps, Path(settings.source)
    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder of Touchstone files")
    files, angles, start, step, response = read_folder(sweeps, folder)
    facts = {"files": f"{files[0].name} to {files[-1].name}"}
    if lacking := missing_angles(angles):
        shown = ", ".join(f"{angle:g}" for angle in lacking[:8])
        _note(f"{folder}: no file for {len(lacking)} of the evenly spaced angles: {shown}°")

    def like_views(file: str) -> NDArray[np.complex128]:
        """Another sweep, which must have the views' axis."""
        other = read_touchstone(file, sweeps.parameter)
        same = other.response.size == response.shape[1] and np.allclose(
            [other.start_hz, other.step_hz], [start, step], rtol=1e-6, atol=0
        )
        if not same:
            raise DataError(
                f"{file}: {other.response.size} frequencies from {other.start_hz / 1e9:.6g} GHz in steps of "
                f"{other.step_hz / 1e6:.6g} MHz; {files[0].name} has {response.shape[1]} from {start / 1e9:.6g} GHz in "
                f"steps of {step / 1e6:.6g} MHz: measure both over one axis"
            )
        return other.response

    background = None
    if sweeps.background is not None:
        background = like_views(sweeps.background.file)
        response, residual = subtract_background(response, background, start, step, sweeps.background.align_m)
        facts["background"] = f"{Path(sweeps.background.file).name}, residual {np.median(residual):.1f} dB"
    if sweeps.reference is not None:
        echo = like_views(sweeps.reference.file)
        empty = like_views(sweeps.reference.background) if sweeps.reference.background is not None else background
        if empty is not None:
            align = sweeps.background.align_m if sweeps.background is not None else None
            echo = subtract_background(echo[None], empty, start, step, align)[0][0]
        response, delay, gain = calibrate(response, echo, settings=sweeps.reference, start_hz=start, step_hz=step)
        facts["calibration"] = f"{delay * 1e9:.4f} ns and {20 * np.log10(gain):.2f} dB by {sweeps.reference.kind}"
    views = _views(settings, _Place(angles_deg=angles), len(files))
    return FrequencyResponse(response, start, step, views=views, **_described(settings, kind, facts))


def _arrays(settings: ImportSettings, kind: str) -> FrequencyResponse:
    names = settings.arrays
    data = read_responses(settings.source, **names.model_dump())
    views = _views(settings, _Place(data.angles_deg, data.positions_m, data.receivers_m), len(data.values))
    described = _described(settings, kind, {})
    if names.axis_kind == "frequency":
        start, step = float(data.axis[0]), float((data.axis[-1] - data.axis[0]) / (data.axis.size - 1))
        return FrequencyResponse(data.values, start, step, views=views, **described)
    response, start, step = _of_taps(data, settings)
    return FrequencyResponse(response, start, step, views=views, **described)


def _of_taps(data: ArrayData, settings: ImportSettings) -> tuple[NDArray[np.complex128], float, float]:
    """Frequency response of complex taps h_l at delays τ_l: H(f) = (K/L) Σ_l h_l exp(−j2π(f − f_c)τ_l).

    Taps Δτ apart fill the band 1/Δτ; where the data's bandwidth is smaller, the K frequencies inside it are kept. The
    factor is such that an isolated path of gain g, sampled as in our own profiles, has |H| = |g|.
    """
    if settings.carrier_hz is None:
        raise ConfigError("carrier_hz: missing key; taps over delay do not say their carrier")
    spacing = float((data.axis[-1] - data.axis[0]) / (data.axis.size - 1))
    if data.axis[0] < 0:
        raise DataError(f"{settings.source}: {settings.arrays.axis} begins at {data.axis[0]:g} s; delays are absolute")
    band = 1 / spacing
    wanted = settings.bandwidth_hz or band
    if wanted > band * (1 + 1e-6):
        raise ConfigError(f"bandwidth_hz = {wanted:g}: taps {spacing:g} s apart hold {band:g} Hz at most")
    length = int(np.ceil(data.axis[-1] / spacing)) + 1  # so that the unambiguous range holds the last tap
    step = band / length
    kept = max(2, min(length, round(wanted / step)))
    number = np.arange(kept) - (kept - 1) / 2
    ramp = np.exp(2j * np.pi * (kept - 1) / 2 * np.arange(data.axis.size) / length)
    spectrum = np.fft.fft(data.values * ramp, length, axis=1)[:, :kept]
    spectrum *= np.exp(-2j * np.pi * number * step * data.axis[0]) * (kept / data.axis.size)
    return spectrum, settings.carrier_hz + float(number[0]) * step, step


def _components(settings: ImportSettings, kind: str) -> Components:
    table = read_components(settings.source)
    views = _views(settings, _Place(table.angles_deg, table.positions_m, table.receivers_m), table.row_size.size)
    return Components(
        table.range_m, table.power, table.row_size, views=views, **_radio(settings, None),
        **_described(settings, kind, {}),
    )  # fmt: skip


def _deepmimo(settings: ImportSettings, kind: str) -> Cir:
    return _of_pairs(settings, kind, read_deepmimo(settings.source))


def _insite(settings: ImportSettings, kind: str) -> Cir:
    source = Path(settings.source)
    files = sorted(source.glob("*.p2m")) if source.is_dir() else [source]
    if not files:
        raise DataError(f"{source}: holds no .p2m file")
    parts = [read_p2m(file, settings.pairs.transmit_power_dbm) for file in files]
    return _of_pairs(settings, kind, parts[0] if len(parts) == 1 else join_pairs(parts, {"files": str(len(parts))}))


def _of_pairs(settings: ImportSettings, kind: str, paths: PairPaths) -> Cir:
    chosen = settings.pairs
    paths = select_pairs(paths, chosen.which, chosen.tolerance_m)
    if not chosen.line_of_sight:
        paths = drop_line_of_sight(paths)
    if paths.n_pair == 0 or paths.n_path == 0:
        raise DataError(f"{settings.source}: no echo in any of {paths.n_pair} pairs; nothing can be imaged")
    apart = bool((paths.receivers_m != paths.transmitters_m).any())
    place = _Place(positions_m=paths.transmitters_m, receivers_m=paths.receivers_m if apart else None)
    return Cir(
        paths.gain.astype(np.complex64),
        paths.delay_s,
        paths.interaction,
        paths.first_point_m,
        paths.row_size,
        views=_views(settings, place, paths.n_pair),
        **_radio(settings, paths.carrier_hz),
        **_described(settings, kind, paths.source),
    )


def _radio(settings: ImportSettings, carrier_hz: float | None) -> dict[str, Any]:
    """Carrier and bandwidth, from the settings or the data."""
    carrier = settings.carrier_hz or carrier_hz
    if carrier is None or settings.bandwidth_hz is None:
        missing = "carrier_hz" if carrier is None else "bandwidth_hz"
        raise ConfigError(f"{missing}: missing key; {Path(settings.source).name} does not say it (--set {missing}=…)")
    return {"carrier_hz": carrier, "bandwidth_hz": settings.bandwidth_hz}


def _described(settings: ImportSettings, kind: str, facts: Mapping[str, str]) -> dict[str, Any]:
    """Extent, antenna, settings and origin; of files the names alone, never where they lay."""
    config = settings.model_dump(mode="json")
    config["source"] = Path(settings.source).name
    config["name"] = settings.name or Path(settings.source).stem
    return {
        "extent_m": float("nan") if settings.extent_m is None else settings.extent_m,
        "antenna": settings.antenna,
        "config": _without_folders(config),
        "provenance": {**provenance(), "importer": kind, **{f"source.{key}": text for key, text in facts.items()}},
    }


def _without_folders(data: Any) -> Any:
    if isinstance(data, dict):
        return {
            key: Path(value).name
            if isinstance(value, str) and key in ("file", "background", "positions", "angle_file")
            else _without_folders(value)
            for key, value in data.items()
        }
    return [_without_folders(item) for item in data] if isinstance(data, list) else data


def _views(settings: ImportSettings, place: _Place, count: int) -> Views:
    """Where the views were measured: as a file of positions says, else as the data do."""
    geometry = settings.geometry
    if geometry.positions is not None:
        numbers, _ = read_columns(
            geometry.positions, "positions file", PLACE[:2], (PLACE[2], *RECEIVER, "azimuth_deg", "elevation_deg")
        )
        if len(numbers["x_m"]) != count:
            raise DataError(f"{geometry.positions}: {len(numbers['x_m'])} positions for {count} views of the data")
        return views_of_columns(
            numbers, geometry.center_m, geometry.pointing, geometry.pair_separation_m, geometry.positions
        )
    if place.positions_m is not None:
        columns = dict(zip(PLACE, place.positions_m.T, strict=True))
        separation = geometry.pair_separation_m
        if place.receivers_m is not None:
            columns |= dict(zip(RECEIVER, place.receivers_m.T, strict=True))
        return views_of_columns(columns, geometry.center_m, geometry.pointing, separation, settings.source)
    if place.angles_deg is None:
        raise ConfigError(
            f"geometry: {Path(settings.source).name} says neither angles nor positions of its {count} views; give "
            "geometry.positions, a CSV file with x_m,y_m[,z_m]"
        )
    return _at_angles(geometry, place.angles_deg)


def _at_angles(geometry: GeometrySettings, angles_deg: NDArray[np.float64]) -> Views:
    """Views at the angles of a turntable or of a sensor on a circle."""
    if geometry.radius_m is None:
        raise ConfigError("geometry.radius_m: missing key; the data say angles only (--set geometry.radius_m=12)")
    turned = -angles_deg if geometry.clockwise else angles_deg
    directions = geometry.zero_deg + (-turned if geometry.angles == "target" else turned)
    views = views_on_circle(geometry.center_m, geometry.radius_m, directions, (geometry.height_m,))
    if geometry.angles == "target":
        return on_turntable(views, turned, geometry.pointing, geometry.pair_separation_m, "geometry.pointing")
    return side_by_side(pointed(views, geometry.pointing, "geometry.pointing"), geometry.pair_separation_m)


def _note(text: str) -> None:
    logging.getLogger("mvla_sim").warning("mvla: note: %s", text)


_IMPORTERS: dict[str, Callable[[ImportSettings, str], Channel]] = {
    "touchstone": _touchstone,
    "arrays": _arrays,
    "components": _components,
    "deepmimo": _deepmimo,
    "insite": _insite,
}
