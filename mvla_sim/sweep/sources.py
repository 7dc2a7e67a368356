"""Where the channels of an experiment come from: scenes, which are traced, and channel files, which are there."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mvla_sim.channel.loading import load_channel
from mvla_sim.channel.simulate import cache_file, simulate
from mvla_sim.engine.cache import cache_folder
from mvla_sim.errors import DataError
from mvla_sim.scene.views import Views
from mvla_sim.scene.world import Scene

__all__ = ["Source", "file_source", "traced_source"]


@dataclass(frozen=True, eq=False)
class Source:
    """Where the channel of some cases comes from."""

    key: str  # what identifies the channel's content, and its name in the cache
    name: str  # what it is called in tables: the scene's name, or the channel file's
    views: Views  # all its views
    scene: Scene | None = None  # the scene that is traced; None for a channel file
    path: Path | None = None  # the channel file; None for a scene
    outline: Any = None  # the truth of a channel file that carries none; None: its own
    plane_height_m: float | None = None  # where its grid lies by default

    @property
    def file(self) -> Path:
        """The channel file; of a scene that in the cache, which need not be there yet."""
        return cache_folder() / "cir" / f"{self.key}.nc" if self.path is None else self.path

    def make(self) -> None:
        """Trace the scene, unless that was done. Raises as :func:`simulate`."""
        if self.scene is not None:
            simulate(self.scene)


def traced_source(scene: Scene) -> Source:
    """The channel of a scene."""
    height = scene.settings.plane_height_m
    return Source(cache_file(scene).stem, scene.name, scene.views, scene, plane_height_m=height)


def file_source(path: str | os.PathLike[str], truth: Scene | None = None) -> Source:
    """The channel in a file, of any kind that imaging takes; ``truth`` has the outline where the file has none.

    Raises DataError: no readable channel file; or it carries no outline and none is given.
    """
    file = Path(path)
    channel = load_channel(file)
    if channel.outline is None and truth is None:
        raise DataError(f"{file}: carries no outline of its target to score against; give truth = a scene file")
    name = str(channel.config.get("name") or file.stem)
    digest = hashlib.sha256(file.read_bytes())
    outline, height = channel.outline, channel.plane_height_m
    if outline is None:
        assert truth is not None
        outline, height = truth.outline, truth.settings.plane_height_m
        digest.update(outline.wkb)
    return Source(f"file-{digest.hexdigest()[:32]}", name, channel.views, None, file, outline, height)
