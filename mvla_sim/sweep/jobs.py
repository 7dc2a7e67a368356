"""What a sweep asks of workers: trace a scene, compute the profiles of a channel, run some of its cases."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from mvla_sim.channel.simulate import cache_file, simulate
from mvla_sim.engine.cache import cache_folder, is_shared, pull, push
from mvla_sim.errors import DataError, OutputError, reason
from mvla_sim.imaging.pipeline import Pipeline, ProfiledChannel
from mvla_sim.scene.world import Scene
from mvla_sim.sweep.batch import ProfileArguments, load_profiles, run_batch
from mvla_sim.sweep.case import Case, Row

__all__ = [
    "Failed", "prepare_here", "prepare_sent", "prepare_shared", "run_cases", "trace_and_send", "trace_and_share",
]  # fmt: skip


@dataclass(frozen=True)
class Failed:
    """Profiles that could not be made; ``damaged`` where their channel file cannot be read."""

    error: str
    damaged: bool


def trace_and_send(scene: Scene) -> bytes:
    """Trace a scene, unless this machine has its CIR, and return the content of the CIR file."""
    file = cache_file(scene)
    if not file.exists():
        simulate(scene)
    return file.read_bytes()


def trace_and_share(scene: Scene) -> None:
    """Trace a scene, unless its CIR is there, and leave it in the shared cache."""
    file = cache_file(scene)
    if is_shared(file):
        return
    if not file.exists():
        simulate(scene)
    push(file)


def prepare_here(file: Path, wanted: ProfileArguments) -> ProfiledChannel | Failed:
    """Compute profiles of a channel file of this machine; see :func:`~mvla_sim.sweep.batch.load_profiles`."""
    try:
        return load_profiles(file, wanted)
    except Exception as error:  # noqa: BLE001 - becomes the error of every case that needs it
        return Failed(reason(error), isinstance(error, DataError) and str(file) in str(error))


def prepare_sent(content: bytes, wanted: ProfileArguments) -> ProfiledChannel | Failed:
    """The same of the content of a file."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "channel.nc"
        file.write_bytes(content)
        return prepare_here(file, wanted)


def prepare_shared(name: str, wanted: ProfileArguments) -> ProfiledChannel | Failed:
    """The same of a CIR of the shared cache, which is kept on this machine as well."""
    file = cache_folder() / "cir" / name
    try:
        pull(file)
    except OutputError as error:
        return Failed(reason(error), False)
    result = prepare_here(file, wanted)
    if isinstance(result, Failed) and result.damaged:
        file.unlink(missing_ok=True)
    return result


def run_cases(channel: ProfiledChannel | Failed, cases: tuple[Case, ...]) -> list[Row] | Failed:
    """Run cases of a channel, one row a case. What the last cases of the same channel had in common is still here."""
    global _last  # noqa: PLW0603 - a worker does one thing at a time
    if isinstance(channel, Failed):
        return channel
    if _last is None or _last.channel is not channel:
        _last = Pipeline(channel)
    return run_batch(_last, cases)


_last: Pipeline | None = None
