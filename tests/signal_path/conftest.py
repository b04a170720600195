"""Three rides take their time: they begin with the session and run beside the other tests, two at a time."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from demo_ride import run
from hidden_ride import begin
from wheelchair_ride import drive

import wanted


def asked_for(request, name):
    """Whether tests of that file are run at all."""
    return any(item.path.name == name for item in request.session.items)


@pytest.fixture(scope="session", autouse=True)
def hidden_ride(request, tmp_path_factory):
    """(process, its folder); None where nobody asks for it."""
    if not asked_for(request, "test_hidden_effect.py"):
        yield None
        return
    folder = tmp_path_factory.mktemp("hidden")
    process = begin(folder)
    yield process, folder
    process.kill()
    process.communicate()


@pytest.fixture(scope="session", autouse=True)
def wheelchair_ride(request, tmp_path_factory):
    """The future of the ride; None where the recording is not on this machine, or nobody asks for it."""
    data = wanted.SHARED / "data" / "wheelchair"
    if not asked_for(request, "test_wheelchair_ride.py"):
        yield None
        return
    with ThreadPoolExecutor(1) as pool:
        yield pool.submit(drive, data, tmp_path_factory.mktemp("ride")) if data.is_dir() else None


@pytest.fixture(scope="session", autouse=True)
def demo_ride(request, hidden_ride, tmp_path_factory):
    """The future of the demo, which begins when the ride with hidden effects is over."""
    if not asked_for(request, "test_demo.py"):
        yield None
        return

    def drive():
        if hidden_ride is not None:
            hidden_ride[0].wait(150)
        return run(tmp_path_factory.mktemp("demo"))

    with ThreadPoolExecutor(1) as pool:
        yield pool.submit(drive)
