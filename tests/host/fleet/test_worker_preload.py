"""Dask preload module of local workers."""

import signal

from hubodo.fleet.worker_preload import dask_setup


def test_a_worker_ignores_the_interrupt_that_a_terminal_sends_to_every_process():
    handler = signal.getsignal(signal.SIGINT)
    try:
        dask_setup(None)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, handler)
