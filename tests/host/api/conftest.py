"""A folder with what the examples open: a drive, a vehicle, a model, a night at rest."""

import pytest

from example_folder import fill


@pytest.fixture(scope="session")
def examples(tmp_path_factory):
    return fill(tmp_path_factory.mktemp("examples"))
