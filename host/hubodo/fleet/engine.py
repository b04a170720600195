"""Distribute logs over processes of this computer or a Dask cluster."""

from __future__ import annotations

import logging
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from hubodo.errors import LinkError
from hubodo.extras import require_extra
from hubodo.fleet.listing import LogLocation
from hubodo.fleet.task import FAILED

if TYPE_CHECKING:
    from distributed import Client

_SCHEDULER_TIMEOUT_S = 10
LOCAL_DASK_SETTINGS = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
}
"""Dask settings for local processes: no dashboard, so frequent monitoring is switched off."""


@contextmanager
def connect_client(scheduler: str | None, workers: int, memory_limit: str) -> Iterator[Client]:
    """Yield a client of the scheduler at this address, or of local processes that end with the block.

    workers, memory_limit: number of local processes and memory of each, such as "2GB". Raises LinkError if
    the scheduler cannot be reached, InputError without Dask or for an invalid limit.
    """
    require_extra("batch", "hubodo batch")
    import dask
    from distributed import Client, LocalCluster

    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=_SCHEDULER_TIMEOUT_S)
        except (OSError, ValueError) as error:
            raise LinkError(
                f"{scheduler}: no scheduler answers ({error}); start one with dask scheduler"
            ) from None
        with client:
            yield client
        return
    with (
        dask.config.set(LOCAL_DASK_SETTINGS),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            memory_limit=memory_limit,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            security=True,  # certificates for this run, because a scheduler executes code of every client
            preload=["hubodo.fleet.worker_preload"],
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


def examine_each(
    client: Client | None, examine: Callable[[LogLocation], dict[str, Any]], locations: Sequence[LogLocation]
) -> Iterator[tuple[LogLocation, dict[str, Any]]]:
    """Yield each log with its row as they finish; a log whose worker died repeatedly has a row, too.

    client: None examines the logs in this process, one after the other. Raises LinkError if the scheduler is
    lost.
    """
    if client is None:
        yield from ((location, examine(location)) for location in locations)
        return
    suspects = []
    for location, outcome in _distribute(client, examine, locations):
        if _lost_its_worker(outcome):
            suspects.append(location)
        else:
            yield location, _row_of(outcome)
    # Dask blames each log that waited at a worker that died; one that dies again alone is the cause.
    for suspect in suspects:
        for location, outcome in _distribute(client, examine, [suspect]):
            yield location, _row_of(outcome)


def _distribute(
    client: Client, examine: Callable[[LogLocation], dict[str, Any]], locations: Sequence[LogLocation]
) -> Iterator[tuple[LogLocation, dict[str, Any] | BaseException]]:
    """Yield each log with its row or with the error that ended its task, as they finish."""
    from distributed import as_completed

    run = uuid.uuid4().hex
    location_by_key = {f"hubodo-{run}-{number}": place for number, place in enumerate(locations)}
    futures = client.map(examine, locations, key=list(location_by_key), pure=False)
    completed = as_completed(futures, with_results=True, raise_errors=False)
    del futures
    for future, outcome in completed:
        if future.status == "finished":
            yield location_by_key[future.key], outcome
        elif future.status == "error":
            yield location_by_key[future.key], outcome[1]
        else:
            raise LinkError("the scheduler is gone; repeat the command to continue with the unfinished logs")
        future.release()


def _row_of(outcome: dict[str, Any] | BaseException) -> dict[str, Any]:
    if not isinstance(outcome, BaseException):
        return outcome
    if _lost_its_worker(outcome):
        cause = "its worker died each time; if memory ran out, give each worker more (--memory-limit)"
    else:
        cause = f"{type(outcome).__name__}: {' '.join(str(outcome).split())}"
    return {"status": FAILED, "error": cause}


def _lost_its_worker(outcome: object) -> bool:
    from distributed.scheduler import KilledWorker

    return isinstance(outcome, KilledWorker)
