"""The dataset card: what is inside, how it was made, under which licence, and how to load it."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from mvla_sim.dataset.access import BenchmarkDataset
from mvla_sim.dataset.campaign import SPLITS
from mvla_sim.dataset.index import INDEX
from mvla_sim.dataset.shard import SHARD_VERSION, shard_name

__all__ = ["CARD", "PICTURE", "card_text", "shown_samples"]

CARD = "README.md"
PICTURE = "scenes.png"
MOST_ERRORS = 10


def shown_samples(dataset: BenchmarkDataset, count: int = 20) -> list[int]:
    """Positions in the dataset of the samples that a picture shows: the first ones of each family in turn, sorted."""
    by_family: dict[str, list[int]] = {}
    for k in range(len(dataset)):
        found = by_family.setdefault(dataset.metadata(k)["family"], [])
        if len(found) < count:
            found.append(k)
        if len(by_family) == len(dataset.campaign.families) and all(len(f) >= count for f in by_family.values()):
            break
    turns = [family[turn] for turn in range(count) for family in by_family.values() if turn < len(family)]
    return sorted(turns[:count])


def card_text(dataset: BenchmarkDataset, picture: str | None = PICTURE) -> str:
    """Text of the card, Markdown, of a dataset with all of its samples; a picture of some scenes lies beside it."""
    parts = (_head(dataset, picture), _statistics(dataset), _made(dataset), _layout(dataset), _loading())
    return "\n".join(parts)


def _head(dataset: BenchmarkDataset, picture: str | None) -> str:
    campaign, index = dataset.campaign, dataset.index
    nx, ny, _ = dataset.grid.counts
    size = sum(entry.bytes for entry in index.shards.values())
    shown = f"\n![Some of the scenes from above: targets and sensor positions]({picture})\n" if picture else ""
    missing = campaign.samples - len(dataset) - len(index.failed)
    part = f" {missing} of {campaign.samples} samples are not made yet." if missing else ""
    return f"""# {campaign.name}

{campaign.description or "Synthetic channel impulse responses with the geometry they belong to."}

{len(dataset)} samples in {len(index.shards)} shards, {size / 2**20:.1f} MiB.{part}
A sample is a scene: the paths of the channel from every position of a sensor (gain, absolute delay, interactions, first
interaction point), the outline of the target, its occupancy on a grid of {nx} × {ny} voxels of
{dataset.grid.spacing_m:g} m, and all settings.
Carrier {campaign.radio.carrier_hz / 1e9:g} GHz, bandwidth {campaign.radio.bandwidth_hz / 1e9:g} GHz.

Licence: {campaign.licence}.
{shown}"""


def _statistics(dataset: BenchmarkDataset) -> str:
    table: Counter[tuple[str, str]] = Counter()
    materials: Counter[str] = Counter()
    numbers: dict[str, list[float]] = {
        name: [] for name in ("views", "paths", "objects", "largest extent D (m)", "scattering coefficient")
    }
    seen: dict[str, set[str]] = {}
    for k in range(len(dataset)):  # one after the other: the settings of all scenes together may be large
        fact = dataset.metadata(k)
        items = fact["settings"]["objects"]
        table[fact["family"], fact["split"]] += 1
        materials.update(str(item["material"]) for item in items)
        for name, value in (
            ("views", fact["views"]), ("paths", fact["paths"]), ("objects", len(items)),
            ("largest extent D (m)", fact["extent_m"]),
        ):  # fmt: skip
            numbers[name].append(value)
        numbers["scattering coefficient"] += [item["scattering_coefficient"] for item in items]
        scene = json.dumps([items, fact["settings"]["trajectory"]], sort_keys=True)
        seen.setdefault(hashlib.sha256(scene.encode()).hexdigest(), set()).add(fact["split"])
    families = [family.name for family in dataset.campaign.families]
    counts = np.array([[table[name, split] for split in SPLITS] for name in families])
    rows: list[list[Any]] = [
        [name, *of.tolist(), of.sum()]
        for name, of in zip([*families, "all"], [*counts, counts.sum(axis=0)], strict=True)
    ]
    ranges = [[name + " of a sample" * (name in ("views", "paths", "objects")), *_range(of)]
              for name, of in numbers.items()]  # fmt: skip
    twins = sum(len(splits) > 1 for splits in seen.values())
    lines = [
        "## Statistics",
        "",
        "Splits are by scene, never by view."
        + f" But {twins} scene{'s were' if twins > 1 else ' was'} drawn several times, in several splits."
        * (twins > 0),
        "",
        *_table(["family", *SPLITS, "all"], rows),
        "",
        *_table(["", "least", "median", "largest"], ranges),
        "",
        f"Materials of the objects: {', '.join(f'{name} {count}' for name, count in materials.most_common())}.",
        "",
    ]
    failed = dataset.index.failed
    if failed:
        lines += [
            f"{len(failed)} sample{'s' * (len(failed) > 1)} could not be made; the others keep their numbers:",
            "",
            *(f"* {failure.sample}: {failure.error}" for failure in failed[:MOST_ERRORS]),
            *([f"* and {len(failed) - MOST_ERRORS} more, listed in {INDEX}"] if len(failed) > MOST_ERRORS else []),
            "",
        ]
    return "\n".join(lines)


def _made(dataset: BenchmarkDataset) -> str:
    campaign = dataset.campaign
    by_shard = {number // campaign.samples_per_shard: k for k, number in enumerate(dataset.numbers)}
    made_with = {_versions(dataset.provenance(k)): None for k in by_shard.values()}
    tracing = campaign.ray_tracing
    kinds = [name for name in ("specular", "diffuse", "diffraction") if getattr(tracing, name)]
    return f"""## How it was made

{"; ".join(made_with)}.
Traced: {", ".join(kinds)}, up to {tracing.max_depth} interaction{"s" * (tracing.max_depth > 1)},
{tracing.diffuse_rays} rays a view for diffuse paths and {tracing.specular_rays} for the others. Sample k is a
function of the seed ({campaign.seed}) and k alone; `{INDEX}` holds the campaign's settings, from which every sample can
be made again:

```sh
mvla dataset verify .            # checksums, schema, splits, truth; a random few samples are made again
```
"""


def _versions(provenance: Mapping[str, str]) -> str:
    """What a shard was made with."""
    packages = ", ".join(f"{name} {provenance.get(name, 'unknown')}" for name in ("sionna-rt", "mitsuba", "drjit"))
    return f"{provenance.get('program', 'unknown program')} with {packages}"


def _layout(dataset: BenchmarkDataset) -> str:
    campaign = dataset.campaign
    last = shard_name(campaign.shards - 1)
    return f"""## Files

| file | what it is |
|---|---|
| `{INDEX}` | schema version, settings, shards with their SHA-256, splits, samples that failed |
| `{shard_name(0)}` … `{last}` | NetCDF-4, schema version {SHARD_VERSION}, {campaign.samples_per_shard} samples each |

In a shard sample s owns `view_count[s]` consecutive views, and view m `row_size[m]` consecutive paths.

| variable | dimensions | unit | meaning |
|---|---|---|---|
| `sample` | sample | 1 | number of the sample |
| `view_count`, `row_size` | sample; view | 1 | views of the sample; paths of the view |
| `gain_real`, `gain_imag` | path | 1 | complex baseband path gain, carrier phase included |
| `delay` | path | s | absolute round-trip delay |
| `interaction` | path | flags | 1 specular, 2 diffuse, 4 refraction, 8 diffraction |
| `first_point` | path, xyz | m | first interaction point |
| `position`, `angle` | view(, xyz) | m, degree | sensor position, and its direction from `center` |
| `receiver`, `boresight` | view, xyz | m, 1 | only where receivers are apart, or antennas are pointed |
| `center`, `target_extent` | sample(, xy) | m | centre of the trajectory; largest extent D |
| `outline_wkt` | sample | m | outline of the target, well-known text |
| `occupancy` | sample, y, x | flags | 1 the target covers or meets the voxel, 2 its boundary does |
| `metadata` | sample | | JSON: sample, family, split, objects, settings of the scene |
| `failed_sample`, `failed_error` | failure | | samples that could not be made |

`sha256` of a shard in the index covers the file (`sha256sum`), `data_sha256` its data alone, whenever it was made.
"""


def _loading() -> str:
    return f"""## Loading

```python
import mvla_sim as mv

train = mv.open_dataset(".", split="train")      # lazy; a PyTorch map-style dataset
sample = train[0]
sample.cir.gain, sample.cir.delay_s, sample.cir.row_size, sample.occupancy, sample.outline, sample.metadata
tree = train.to_xarray()                         # labelled arrays, a node a shard, not loaded
```

In MATLAB, or with any program that reads NetCDF-4 or HDF5:

```matlab
f = '{shard_name(0)}';  s = 1;  m = 1;                              % sample and view within the shard
views = double(ncread(f, 'view_count'));  n = double(ncread(f, 'row_size'));  last = cumsum(n);
v = sum(views(1:s-1)) + m;  rows = last(v) - n(v) + 1 : last(v);
tau = ncread(f, 'delay');  g = ncread(f, 'gain_real') + 1i * ncread(f, 'gain_imag');
plot(tau(rows) * 1e9, 20 * log10(abs(g(rows))), '.')
occupancy = ncread(f, 'occupancy');  imagesc(occupancy(:, :, s)')
```
"""


def _range(values: Iterable[float]) -> list[str]:
    found = np.array(list(values), float)
    return [f"{v:.6g}" for v in (found.min(), np.median(found), found.max())] if found.size else ["–"] * 3


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> list[str]:
    lines = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(str(cell) for cell in line) + " |" for line in lines]
