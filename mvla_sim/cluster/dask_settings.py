"""What a site's configuration of Dask may do here: nothing to local workers, and one line where it is broken.

Dask reads YAML files from /etc/dask, ~/.config/dask and the folder that DASK_CONFIG names, when it is first imported.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

from mvla_sim.errors import ConfigError

__all__ = ["only_these_settings", "readable_configuration"]

_BROKEN = "A dask config file at "


@contextlib.contextmanager
def readable_configuration() -> Iterator[None]:
    """Turn a file of settings that Dask cannot read into one line; whatever imports it first, meets the error.

    Raises
    ------
    ConfigError
        The file, and what is wrong with it.
    """
    try:
        yield
    except ValueError as error:
        if not str(error).startswith(_BROKEN):
            raise
        told = " ".join(str(error).removeprefix(_BROKEN).split())
        raise ConfigError(
            f"Dask's configuration: {told}; mend that file, or let DASK_CONFIG name a folder without it"
        ) from error


@contextlib.contextmanager
def only_these_settings(settings: Mapping[str, Any]) -> Iterator[None]:
    """Within the block Dask has its defaults and these settings, whatever files and DASK_ variables say.

    Worker processes that are started in it have the same.
    """
    import dask  # noqa: PLC0415 - where its files are broken, opening a cluster says so
    import distributed  # noqa: F401, PLC0415 - adds its defaults

    with dask.config.set(dask.config.merge(*dask.config.defaults)), dask.config.set(dict(settings)):
        yield
