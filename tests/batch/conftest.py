"""One Dask cluster shared by all tests of a file that do not test its start."""

import pytest


@pytest.fixture(scope="module")
def here():
    """Yield the options that send a batch to the shared cluster.

    Its worker is a thread of this process, which a batch talks to as to any other: what it would import
    has been imported, while a process of its own begins with seconds of that. Those are in `test_engines`.
    """
    # Seconds of imports, too, for processes that run none of these tests.
    import dask
    from distributed import LocalCluster

    from hubodo.fleet.engine import LOCAL_DASK_SETTINGS

    with (
        dask.config.set(LOCAL_DASK_SETTINGS),
        LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            processes=False,
            protocol="tcp://",
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
        ) as cluster,
    ):
        yield ("--scheduler", cluster.scheduler_address)
