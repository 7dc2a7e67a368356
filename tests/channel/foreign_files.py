"""Writers of small files in the formats of other ray tracers, and made-up paths to put into them."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import numpy as np
import scipy.io

from mvla_sim.channel.cir import INTERACTIONS

SPECULAR, DIFFUSE, REFRACTION, DIFFRACTION = (
    INTERACTIONS[name] for name in ("specular", "diffuse", "refraction", "diffraction")
)
DIGITS = {"R": 1, "D": 2, "DS": 3, "T": 4}
BITS = {"R": SPECULAR, "D": DIFFRACTION, "d": DIFFRACTION, "DS": DIFFUSE, "T": REFRACTION}


@dataclass(frozen=True)
class Ray:
    """One path: its power relative to what was transmitted, and what it meets on its way."""

    power_db: float
    phase_deg: float
    delay_s: float
    kinds: tuple[str, ...] = ()
    points: tuple[tuple[float, float, float], ...] = ()

    @property
    def bits(self):
        return int(np.bitwise_or.reduce([0, *(BITS[kind] for kind in self.kinds)]))

    @property
    def gain(self):
        return 10 ** (self.power_db / 20) * np.exp(1j * np.deg2rad(self.phase_deg))

    @property
    def code(self):
        return int("".join(str(DIGITS[kind]) for kind in self.kinds) or "0")


@dataclass(frozen=True)
class Link:
    """A receiver and the paths that reach it."""

    receiver: tuple[float, float, float]
    rays: list[Ray] = field(default_factory=list)


def random_links(seed, n_receiver, most_rays=4, most_kinds=3):
    """Links with numbers that float32 and six printed digits hold; the first is silent if there are several."""
    rng = np.random.default_rng(seed)

    def ray():
        kinds = tuple(rng.choice(list(DIGITS), rng.integers(0, most_kinds + 1)))
        points = tuple(tuple(rng.integers(-99, 99, 3) / 4) for _ in kinds)
        delay = rng.integers(1, 2**20) / 2**40
        return Ray(rng.integers(-1200, -300) / 8, rng.integers(-720, 720) / 4, delay, kinds, points)

    links = [
        Link(tuple(rng.integers(-99, 99, 3) / 4), [ray() for _ in range(rng.integers(1, most_rays + 1))])
        for _ in range(n_receiver)
    ]
    return [Link(links[0].receiver), *links[1:]] if n_receiver > 1 else links


def deepmimo_arrays(transmitter, links, dtype=np.float32):
    """Arrays of one transmitter and one receiver set, padded with NaN, in the order in which the rays are given."""
    slots = max([len(link.rays) for link in links], default=0)
    deep = max([len(ray.kinds) for link in links for ray in link.rays], default=0)
    arrays = {name: np.full((len(links), slots), np.nan, dtype) for name in ("power", "phase", "delay", "inter")}
    arrays["inter_pos"] = np.full((len(links), slots, deep, 3), np.nan, dtype)
    arrays["tx_pos"] = np.array([transmitter], dtype)
    arrays["rx_pos"] = np.array([link.receiver for link in links], dtype).reshape(-1, 3)
    for i, link in enumerate(links):
        for j, ray in enumerate(link.rays):
            arrays["power"][i, j] = ray.power_db
            arrays["phase"][i, j] = ray.phase_deg
            arrays["delay"][i, j] = ray.delay_s
            arrays["inter"][i, j] = ray.code
            for k, point in enumerate(ray.points):
                arrays["inter_pos"][i, j, k] = point
    return arrays


def write_array(folder, name, values, code="t000_tx000_r001", form="npz"):
    """Write one array the way DeepMIMO does; the form "plain mat" is MATLAB's without compression."""
    file = folder / f"{name}_{code}.{form.split()[-1]}"
    if form == "npz":
        np.savez_compressed(file, **{name: values})
    elif form == "npy":
        np.save(file, values)
    else:
        scipy.io.savemat(file, {name: values}, do_compression=form == "mat")
    return file


def write_params(folder, frequency=3.5e9, raytracer="Remcom Wireless Insite"):
    """Write the facts on a scenario, with the keys DeepMIMO gives them."""
    sets = {
        f"txrx_set_{i}": {"name": "set", "id": i, "id_orig": i, "is_tx": i == 0, "is_rx": i > 0, "num_points": 1}
        for i in range(2)
    }
    rt_params = {"raytracer_name": raytracer, "raytracer_version": "3.3.0", "max_path_depth": 5, "raw_params": {}}
    if frequency is not None:
        rt_params["frequency"] = frequency
    params = {
        "version": "4.0.5", "rt_params": rt_params, "txrx_sets": sets, "materials": {}, "scene": {"num_scenes": 1},
    }  # fmt: skip
    (folder / "params.json").write_text(json.dumps(params, indent=2))


def write_deepmimo(folder, transmitter, links, *, code="t000_tx000_r001", form="npz", dtype=np.float32, **params):
    """Write a scenario of one transmitter and one receiver set; called again, add another to it."""
    folder.mkdir(exist_ok=True)
    write_params(folder, **params)
    for name, values in deepmimo_arrays(transmitter, links, dtype).items():
        write_array(folder, name, values, code, form)
    return folder


def write_p2m(file, transmitter, links, *, phases=True, transmit_power_dbm=0.0, header="# a comment\n"):
    """Write the paths of one transmitter the way Wireless InSite prints them, but with every digit of the delays."""

    def xyz(point):
        return " ".join(f"{value:15.7E}" for value in point)

    lines = [f"{len(links):7d}"]
    for number, link in enumerate(links, 1):
        lines.append(f"{number:6d}{len(link.rays):6d}")
        if link.rays:
            lines.append(" -60.00   0.10000E-06   0.10000E-08")
        for nth, ray in enumerate(link.rays, 1):
            phase = f" {ray.phase_deg:10.4f}" if phases else ""
            power = ray.power_db + transmit_power_dbm
            lines.append(f"{nth:5d}{len(ray.kinds):4d} {power:10.4f}{phase} {ray.delay_s:.16E} 90.0 0.0 90.0 180.0")
            lines.append("-".join(["Tx", *ray.kinds, "Rx"]) + " ")
            lines += [xyz(point) for point in (transmitter, *ray.points, link.receiver)]
    file.write_text(header + "\n".join(lines) + "\n")
    return file


def assert_holds(paths, transmitter, links):
    """Check that the pairs are these links, each with its rays by rising delay."""
    np.testing.assert_array_equal(paths.transmitters_m, np.reshape([transmitter] * len(links), (-1, 3)))
    np.testing.assert_array_equal(paths.receivers_m, np.reshape([link.receiver for link in links], (-1, 3)))
    np.testing.assert_array_equal(paths.row_size, [len(link.rays) for link in links])
    rays = [ray for link in links for ray in sorted(link.rays, key=lambda ray: ray.delay_s)]
    first = [ray.points[0] if ray.points else (np.nan,) * 3 for ray in rays]
    np.testing.assert_array_equal(paths.delay_s, [ray.delay_s for ray in rays])
    np.testing.assert_array_equal(paths.interaction, [ray.bits for ray in rays])
    np.testing.assert_array_equal(paths.first_point_m, np.reshape(first, (-1, 3)))
    np.testing.assert_allclose(paths.gain, [ray.gain for ray in rays], rtol=1e-12)  # float64 of exact decibels
    types = {
        "transmitters_m": "f8", "receivers_m": "f8", "row_size": "i8", "gain": "c16", "delay_s": "f8",
        "interaction": "u1", "first_point_m": "f4",
    }  # fmt: skip
    assert {name: getattr(paths, name).dtype.str.lstrip("<|") for name in types} == types


def damaged(good, cuts, changes):
    """Bytes of a file with some changed and its end cut off."""
    bad = bytearray(good)
    for place, value in changes:
        bad[place % len(bad)] = value
    return bytes(bad[: len(bad) - cuts % len(bad)])
