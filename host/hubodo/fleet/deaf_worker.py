"""What Dask loads into each worker of this computer: ctrl-C, which a terminal sends to all, is not for it."""

import signal


def dask_setup(worker: object) -> None:
    """The command hears it, keeps what is finished and ends the workers."""
    del worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)
