"""What all tests share: one hypothesis profile, importable helpers, and which of them wait for the clock."""

import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

HERE = Path(__file__).parent
# These wait for ports, processes or the clock: beside others that keep the machine busy they would be late.
REAL_TIME = (
    "signal_path/test_demo.py",
    "signal_path/test_hidden_effect.py",
    "signal_path/test_links.py",
    "signal_path/test_wheelchair_ride.py",
    "host/ingest",
    "host/sensors/test_north_live.py",
    "host/test_live_map.py",
    "host/test_live_odometry.py",
    "host/test_verb_play.py",
    "host/test_verb_record.py",
)

# Rides that take their time begin with the first test of this folder: it comes first. Their own tests come
# last, but for those that watch how late each sample is: no ride may run beside them.
FIRST = "signal_path"
LAST = (
    *(f"signal_path/test_{name}.py" for name in ("wheelchair_ride", "hidden_effect", "demo")),
    *(f"host/test_{name}.py" for name in ("live_map", "live_odometry", "verb_play", "verb_record")),
)

sys.path.insert(0, str(HERE))

settings.register_profile(
    "hubodo", deadline=None, print_blob=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("hubodo")


def pytest_collection_modifyitems(items):
    alone = tuple(HERE / name for name in REAL_TIME)
    for item in items:
        if any(item.path.is_relative_to(path) for path in alone):
            item.add_marker(pytest.mark.real_time)
    last = [HERE / name for name in LAST]

    def place(item):
        if item.path in last:
            return 2 + last.index(item.path)
        return 0 if item.path.is_relative_to(HERE / FIRST) else 1

    items.sort(key=place)
