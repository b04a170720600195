"""Makes the firmware files and a fake port of MicroPython importable."""

import sys
from pathlib import Path

from fakes import fake_port

fake_port.install(fake_port.PORT_TICKS)
sys.path.insert(0, str(Path(__file__).parents[2] / "firmware"))
# CPython could import these native versions: tests use the plain ones, and compare both.
sys.modules["fast_float"] = None  # type: ignore[assignment]
