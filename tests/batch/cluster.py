"""A Dask cluster on loopback for a test: a scheduler in this process, workers in others."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

TIMEOUT_S = 90.0


@dataclass(frozen=True)
class Cluster:
    """Address of the scheduler, and worker processes that are not restarted when killed (no nanny)."""

    address: str
    workers: tuple[subprocess.Popen[bytes], ...]


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[Cluster]:
    """Start `dask worker` processes and yield once all are connected to their scheduler."""
    from distributed import Client, LocalCluster

    with ExitStack() as stack:
        words = {"protocol": "tcp://", "host": "127.0.0.1", "dashboard_address": None}
        address = stack.enter_context(LocalCluster(n_workers=0, processes=False, **words)).scheduler_address
        words = ["--nthreads", "1", "--no-nanny", "--local-directory", str(folder), "--no-dashboard"]
        started = tuple(
            stack.enter_context(_process(folder, "worker", address, "--name", str(number), *words))
            for number in range(workers)
        )
        with Client(address, timeout=TIMEOUT_S) as client:
            client.wait_for_workers(workers, timeout=TIMEOUT_S)
        yield Cluster(address, started)


@contextmanager
def _process(folder: Path, what: str, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-m", "dask", what, *words]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with (folder / f"{what}.log").open("ab") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, env=environment, cwd=folder)
    try:
        yield process
    finally:
        process.kill()
        process.wait()
