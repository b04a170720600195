"""Two cases for all tests here: a wheel that leans, and one with nothing hidden; 60 s each."""

import pytest

from gap_matrix.make_case import make
from gap_runs import gap

SEED = 3


@pytest.fixture(scope="session")
def camber(tmp_path_factory):
    """(folder, what is hidden): the right wheel leans by some millirad."""
    folder = tmp_path_factory.mktemp("camber")
    return folder, make(folder, SEED, ["wheel_camber"], "strong", scope="right", duration=60.0, rate_hz=50.0)[
        0
    ]


@pytest.fixture(scope="session")
def named(camber, tmp_path_factory):
    """The run of the verb on that case."""
    folder, _ = camber
    return gap(tmp_path_factory.mktemp("named") / "out", folder / "model.toml", folder)


@pytest.fixture(scope="session")
def nothing(tmp_path_factory):
    """A folder in which nothing is hidden."""
    folder = tmp_path_factory.mktemp("nothing")
    make(folder, SEED, [], duration=60.0, rate_hz=50.0, vibration=0.0)
    return folder
