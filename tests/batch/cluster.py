"""A Dask cluster of real processes on loopback: one scheduler and its workers, ended with the test."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

LONGEST_S = 90.0


@dataclass(frozen=True)
class Cluster:
    """address: of the scheduler. workers: the processes, each without a nanny: what is killed stays dead."""

    address: str
    workers: tuple[subprocess.Popen[bytes], ...]


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[Cluster]:
    """`dask scheduler` and so many `dask worker`; yields once all are there."""
    from distributed import Client

    told = folder / "scheduler.json"
    with ExitStack() as stack:
        common = ["--scheduler-file", str(told), "--no-dashboard"]
        stack.enter_context(_process(folder, "scheduler", "--host", "127.0.0.1", "--port", "0", *common))
        _wait(told.is_file)
        words = ["--nthreads", "1", "--no-nanny", "--local-directory", str(folder), *common]
        started = tuple(
            stack.enter_context(_process(folder, "worker", "--name", str(number), *words))
            for number in range(workers)
        )
        with Client(scheduler_file=str(told), timeout=LONGEST_S) as client:
            client.wait_for_workers(workers, timeout=LONGEST_S)
            address = client.scheduler.address
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


def _wait(come) -> None:
    end = time.monotonic() + LONGEST_S
    while not come():
        assert time.monotonic() < end, "the scheduler did not come up"
        time.sleep(0.05)
