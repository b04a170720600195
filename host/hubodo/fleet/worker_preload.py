"""Dask preload module of local workers: ignore ctrl-C, which a terminal sends to every process."""

import signal


def dask_setup(worker: object) -> None:
    """Ignore SIGINT; the command handles it, saves finished results and stops the workers."""
    del worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)
