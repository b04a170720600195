"""One Dask cluster shared by all tests of a file that do not test its start."""

import pytest


@pytest.fixture(scope="module")
def here():
    """Yield the options that send a batch to the shared cluster.

    Its worker is a thread of this process, so that no import takes time; workers in separate processes are
    tested in `test_engines`.
    """
    # Imported here, as the import takes seconds in processes that run none of these tests.
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
