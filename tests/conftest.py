"""Shared set-up of all tests: hypothesis profile, import path of the helpers, order of execution."""

import ctypes
import gc
import sys
from functools import cache
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from hubodo.effects import BY_NAME

TESTS = Path(__file__).parent
LONGEST_FILES = (
    *("host/web/test_recordings_in_browser.py", "host/fuse/test_wheel_calibration.py"),
    *("signal_path/test_north_table.py", "host/gap/test_gap_watch.py", "gap_matrix"),
    *(
        "host/web/test_page_in_browser.py",
        "host/fuse/test_wheel_slip.py",
        "host/sensors/heading/test_heading.py",
    ),
    *(
        "signal_path/test_doctor_node.py",
        "firmware/test_firmware_boards.py",
        "firmware/test_firmware_wifi.py",
    ),
    *("signal_path/test_flash_fleet.py", "chip", "host/fuse/test_graph_live.py"),
    *("batch/test_engines.py", "host/fuse/test_wheel_consistency.py", "host/fuse/test_wheel_clipped.py"),
    *(
        "host/ingest/live/test_held_up.py",
        "host/sensors/allan/test_allan_fit.py",
        "host/sensors/imu/test_imu_calibrate.py",
    ),
    *(
        "signal_path/test_flash_cut.py",
        "firmware/test_firmware_memory.py",
        "host/fuse/test_wheel_outage_model.py",
    ),
    *("signal_path/test_doctor.py", "firmware/test_firmware_bias_filter.py", "host/fuse/test_wheel_car.py"),
    "signal_path/test_radio.py",
    *("signal_path", "host/verbs/test_verb_node.py", "host/api"),
    *("firmware", "host/fuse", "host/sensors", "host/gap"),
)
"""The longest files run first, so that no process is left with one of them at the end.

The first of each line waits more than it works, so that some processes wait while others work.
"""

sys.path.insert(0, str(TESTS))

# Imported modules and collected tests stay alive, so searching them for garbage is wasted time.
gc.disable()

# Freed arrays of megabytes are reused instead of being returned to the system.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
if mallopt := getattr(ctypes.CDLL(None), "mallopt", None):
    mallopt(_M_MMAP_THRESHOLD, 1 << 30)
    mallopt(_M_TRIM_THRESHOLD, 1 << 30)

for profile, examples in (("hubodo", 40), ("wide", 400)):
    settings.register_profile(
        profile,
        max_examples=examples,
        deadline=None,
        print_blob=True,
        suppress_health_check=[HealthCheck.too_slow],
    )
settings.load_profile("hubodo")


def pytest_addoption(parser):
    parser.addoption("--kills", type=int, default=6, help="how many recorders faults/test_kill.py kills")


@cache
def _place(path):
    """Return the rank of a file among the longest; shorter files come last."""
    within = path.relative_to(TESTS).as_posix() + "/"
    long = [index for index, name in enumerate(LONGEST_FILES) if within.startswith(name + "/")]
    return long[0] if long else len(LONGEST_FILES)


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: _place(item.path))


def pytest_collection_finish():
    # The collected tests stay alive: they are excluded from garbage collection.
    gc.freeze()
    # Each recording asks whether objects are excluded; counting all of them would take a tenth of a second.
    gc.get_freeze_count = lambda: 1
    gc.set_threshold(20_000, 20, 20)
    gc.enable()


def _restore_effects():
    before = dict(BY_NAME)
    yield
    BY_NAME.clear()
    BY_NAME.update(before)


@pytest.fixture(scope="module", autouse=True)
def restore_effects():
    """Remove the effects that a test file has loaded, such as those of `--candidates field`."""
    yield from _restore_effects()


@pytest.fixture
def restore_effects_after_each():
    """Remove the effects that a test has loaded."""
    yield from _restore_effects()
