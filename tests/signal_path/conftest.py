"""Two rides take their time: they begin with the first test here and run beside the others."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from hidden_ride import begin
from wheelchair_ride import drive

from shared_data import where


@pytest.fixture(scope="session", autouse=True)
def hidden_ride(tmp_path_factory):
    """(process, its folder)"""
    folder = tmp_path_factory.mktemp("hidden")
    process = begin(folder)
    yield process, folder
    process.kill()
    process.communicate()


@pytest.fixture(scope="session", autouse=True)
def wheelchair_ride(tmp_path_factory):
    """The future of the ride; none where the recording is not on this machine."""
    data = where("wheelchair")
    with ThreadPoolExecutor(1) as pool:
        yield pool.submit(drive, data, tmp_path_factory.mktemp("ride")) if data.is_dir() else None
