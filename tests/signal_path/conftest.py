"""One ride takes its time: it begins with the first test here and runs beside the others."""

import pytest
from hidden_ride import begin


@pytest.fixture(scope="session", autouse=True)
def hidden_ride(tmp_path_factory):
    """(process, its folder)"""
    folder = tmp_path_factory.mktemp("hidden")
    process = begin(folder)
    yield process, folder
    process.kill()
    process.communicate()
