"""A folder with the files that the examples open: a drive, a vehicle, a model, a static night."""

import pytest

from example_folder import write_example_files


@pytest.fixture(scope="session")
def examples(tmp_path_factory):
    return write_example_files(tmp_path_factory.mktemp("examples"))
