"""What all tests share: one hypothesis profile, helpers that can be imported, and who goes first."""

import ctypes
import gc
import sys
from pathlib import Path

from hypothesis import HealthCheck, settings

HERE = Path(__file__).parent
LONGEST = ("signal_path", "chip", "firmware", "host/sensors/test_north_live.py", "host/fuse")
"""They go first: so no process is left with one of them when the others are done."""

sys.path.insert(0, str(HERE))

# Arrays of megabytes come and go: what one leaves is given to the next, and not back to the system.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
if mallopt := getattr(ctypes.CDLL(None), "mallopt", None):
    mallopt(_M_MMAP_THRESHOLD, 1 << 30)
    mallopt(_M_TRIM_THRESHOLD, 1 << 30)

settings.register_profile(
    "hubodo", deadline=None, print_blob=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("hubodo")


def pytest_collection_modifyitems(items):
    def place(item):
        long = [index for index, name in enumerate(LONGEST) if item.path.is_relative_to(HERE / name)]
        return long[0] if long else len(LONGEST)

    items.sort(key=place)


def pytest_collection_finish():
    # Thousands of tests stay: the collector need not look at them again and again.
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
