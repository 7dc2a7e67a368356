"""What must not change: images of all methods from one small channel, and stored tables and verdicts.

``python tests/golden/check.py --write FILE`` before a change and ``--compare FILE`` after it, on one machine, tell
whether a bit of them differs. ``--regenerate`` writes ``images.json``, which the test reads; see README.md.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import sys
from pathlib import Path

import numpy as np

import mvla_sim as mv
from mvla_sim.imaging.method import METHODS

OWN_METHODS = [method.name for method in METHODS.own()]
HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "imaging"))
from cases import channel, ring  # noqa: E402 - beside this folder

STORED = HERE / "images.json"
GRID = ["grid.size_m=[4,4,0]", "grid.spacing_m=0.1"]
CASES = {
    "plain": [],
    "few views, loud noise": ["snr_db=0", "interval_deg=30", "offset=1"],
    "exponential, one reference": ['noise.kind="exponential"', 'noise.reference="all"', "seed=3"],
    "complex": ['noise.kind="complex"'],
    "impaired": [
        "impairments.clutter_paths=3.0", "impairments.position_error_m=0.01", "impairments.missing_share=0.2",
        "impairments.timing_jitter_s=1e-10",
    ],
    "automatic": ['threshold="auto"'],
    "kaiser, five raw peaks": ['pdp.window="kaiser"', "peaks.max_peaks=5", "peaks.refine=false"],
    "given thresholds": ["threshold.top_percent=5", "threshold.min_support_deg=20"],
}  # fmt: skip
SHORT = ("snr_db", "interval_deg", "offset", "seed", "threshold")
"""Arguments of ``imaging_settings``; what has a dot is an override."""
TIMES = {"seconds"}
"""Columns of tables that differ from run to run."""


def made():
    """The channel: a square of 3 m seen from 36 views, each corner and edge point with a gain of its own."""
    rng = np.random.default_rng(12)
    side = np.linspace(-1.5, 1.5, 16)
    edge = np.full_like(side, 1.5)
    sides = ((side, edge), (side, -edge), (edge, side), (-edge, side))
    points = np.concatenate([np.stack(pair, axis=1) for pair in sides])
    views = ring(36)
    distance = np.linalg.norm(views.positions_m[:, None, :2] - points, axis=2)
    gain = 1e-4 * (rng.standard_normal(distance.shape) + 1j * rng.standard_normal(distance.shape))
    return channel([list(zip(r, g, strict=True)) for r, g in zip(distance, gain, strict=True)], views, extent_m=3.0)


def images():
    """(case, method) and its image, or the error that says why there is none."""
    cir = made()
    for case, settings in CASES.items():
        for method in OWN_METHODS:
            own = dict(item.split("=", 1) for item in settings)
            named = {key: json.loads(own.pop(key)) for key in SHORT if key in own}
            if method == "bp-coherent" and "noise.kind" not in own:
                named["snr_db"] = "none"  # what noise added to powers leaves no phase for
            try:
                chosen = mv.imaging_settings([*GRID, *(f"{k}={v}" for k, v in own.items())], method=method, **named)
                yield f"{case}: {method}", mv.reconstruct(cir, chosen)
            except mv.MvlaError as error:
                yield f"{case}: {method}", error


def figures(image):
    """Figures of an image that another processor gives too, within a tolerance."""
    score, support = image.score.ravel().astype(float), image.support_deg
    places = np.random.default_rng(1).choice(score.size, 20, replace=False)
    levels = [] if support is None else np.histogram(support, np.arange(0, 361, 30))[0].tolist()
    return {
        "sum": float(score.sum()),
        "max": float(score.max()),
        "sampled": [float(f"{value:.8g}") for value in score[places]],
        "support": levels,
        "occupied": None if image.occupied is None else int(image.occupied.sum()),
    }


def digest(*arrays):
    """Of all bits; what is missing counts as such."""
    parts = [b"none" if array is None else np.ascontiguousarray(array).tobytes() for array in arrays]
    return hashlib.sha256(b"|".join(parts)).hexdigest()[:16]


def fingerprints(results=None):
    """Hashes of all images, and of ``*/table.csv`` apart from times and ``claims.csv`` in a folder of results."""
    found = {
        name: type(image).__name__ if isinstance(image, mv.MvlaError)
        else digest(image.score, image.support_deg, image.occupied)
        for name, image in images()
    }  # fmt: skip
    for file in sorted([*Path(results).glob("*/table.csv"), *Path(results).glob("claims.csv")] if results else []):
        with file.open(newline="", encoding="utf-8") as text:
            rows = [{key: value for key, value in row.items() if key not in TIMES} for row in csv.DictReader(text)]
        found[str(file.relative_to(results))] = hashlib.sha256(json.dumps(rows).encode()).hexdigest()[:16]
    return found


def main():
    """Write, compare, or renew what the test reads."""
    parser = argparse.ArgumentParser(description=__doc__)
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--write", metavar="FILE", type=Path)
    action.add_argument("--compare", metavar="FILE", type=Path)
    action.add_argument("--regenerate", action="store_true")
    parser.add_argument("--results", metavar="FOLDER", help="as `mvla reproduce` writes it")
    given = parser.parse_args()
    if given.regenerate:
        stored = {name: None if isinstance(one, mv.MvlaError) else figures(one) for name, one in images()}
        STORED.write_text("{\n" + ",\n".join(f'"{k}": {json.dumps(v)}' for k, v in stored.items()) + "\n}\n")
        return 0
    found = fingerprints(given.results)
    if given.write:
        given.write.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        return 0
    before = json.loads(given.compare.read_text(encoding="utf-8"))
    differing = [name for name in {**before, **found} if before.get(name) != found.get(name)]
    sys.stdout.write("\n".join(["differ:", *differing] if differing else [f"all {len(found)} are the same"]) + "\n")
    return bool(differing)


if __name__ == "__main__":
    sys.exit(main())
