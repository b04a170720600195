"""What all tests share: one hypothesis profile, importable helpers, and which of them wait for the clock."""

import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

HERE = Path(__file__).parent
# These wait for ports, processes or the clock: beside others that keep the machine busy they would be late.
REAL_TIME = (
    "signal_path/test_hidden_effect.py",
    "signal_path/test_links.py",
    "signal_path/test_pico.py",
    "signal_path/test_stalled_host.py",
    "signal_path/test_wheelchair_ride.py",
    "host/flash",
    "host/ingest",
    "host/emulator/test_emulated_pico_link.py",
    "host/emulator/test_virtual_board.py",
    "host/emulator/test_virtual_board_link.py",
    "host/sensors/test_north_live.py",
    "host/test_live_map.py",
    "host/test_live_odometry.py",
    "host/test_verb_play.py",
    "host/test_verb_record.py",
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
