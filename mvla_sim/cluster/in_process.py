"""Tasks in this process, one after the other, without Dask."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from typing import Any

from mvla_sim.cluster.interface import Arguments, Cluster, Finished, Shared
from mvla_sim.cluster.worker import attempt, single_threaded_algebra
from mvla_sim.interrupt import deferred_interrupt

__all__ = ["InProcess"]


class InProcess(Cluster):
    """No other process. Ctrl-C waits for the end of a task, and is raised when its result has been taken."""

    def _run(
        self, function: Callable[..., Any], tasks: Iterable[Arguments], label: str, idle: Callable[[], None]
    ) -> Generator[tuple[int, Finished]]:
        del label, idle
        for number, task in enumerate(tasks):
            with deferred_interrupt() as check, single_threaded_algebra():
                arguments = [_value(part) if isinstance(part, Shared) else part for part in task]
                finished = attempt("this process", function, *arguments)
            yield number, finished
            check()


def _value(shared: Shared) -> Any:
    if shared.kept is None:
        finished = attempt("this process", shared.function, *shared.arguments)
        shared.kept = finished.value if finished.error is None else finished
    return shared.kept
