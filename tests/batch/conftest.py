"""One Dask cluster for all tests of a process that do not ask how it is started."""

import pytest
from distributed import LocalCluster


@pytest.fixture(scope="session")
def here():
    """The options that send a batch there."""
    with LocalCluster(
        n_workers=1, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0"
    ) as cluster:
        yield ("--scheduler", cluster.scheduler_address)
