"""Logs shared out among processes of this computer or a cluster: Dask does it, nothing here schedules."""

from __future__ import annotations

import logging
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from hubodo.errors import LinkError
from hubodo.extras import require_extra
from hubodo.fleet.listing import LogPlace
from hubodo.fleet.task import FAILED

if TYPE_CHECKING:
    from distributed import Client

_CONNECT_S = 10
UNWATCHED = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
}
"""Dask's settings for this computer's processes: no page shows what it would look at many times a second."""


@contextmanager
def engine(scheduler: str | None, workers: int, memory_limit: str) -> Iterator[Client]:
    """A client of the scheduler at this address, or of processes on this computer that end with the block.

    workers: processes, memory_limit: of each, as "2GB"; of this computer's alone. Raises LinkError where the
    scheduler cannot be reached, InputError without Dask and for a limit that is none.
    """
    require_extra("batch", "hubodo batch")
    import dask
    from distributed import Client, LocalCluster

    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=_CONNECT_S)
        except (OSError, ValueError) as error:
            raise LinkError(
                f"{scheduler}: no scheduler answers ({error}); start one with dask scheduler"
            ) from None
        with client:
            yield client
        return
    with (
        dask.config.set(UNWATCHED),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            memory_limit=memory_limit,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            security=True,  # certificates for this run: a scheduler runs what anybody sends who reaches it
            preload=["hubodo.fleet.deaf_worker"],
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


def each(
    client: Client, work: Callable[[LogPlace], dict[str, Any]], places: Sequence[LogPlace]
) -> Iterator[tuple[LogPlace, dict[str, Any]]]:
    """Each log with its row, as they come. A log whose worker was lost again and again has a row, too.

    Raises LinkError where the scheduler is gone.
    """
    from distributed import as_completed

    run = uuid.uuid4().hex
    names = {f"hubodo-{run}-{number}": place for number, place in enumerate(places)}
    futures = client.map(work, places, key=list(names), pure=False)
    coming = as_completed(futures, with_results=True, raise_errors=False)
    del futures
    for future, made in coming:
        place = names[future.key]
        if future.status == "finished":
            yield place, made
        elif future.status == "error":
            yield place, {"status": FAILED, "error": _lost(made[1])}
        else:
            raise LinkError("the scheduler is gone; the same command goes on with what is not finished")
        future.release()


def _lost(error: BaseException) -> str:
    from distributed.scheduler import KilledWorker

    if isinstance(error, KilledWorker):
        return "its worker died each time; if memory ran out, give each worker more (--memory-limit)"
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
