"""Puts the firmware's files and a stand-in for its port where tests can import them."""

import sys
from pathlib import Path

from fakes import fake_port

fake_port.install(fake_port.PORT_TICKS)
sys.path.insert(0, str(Path(__file__).parents[2] / "firmware"))
# CPython would take these native twins for its own: the plain versions are tested, the twins beside them.
sys.modules["fast_float"] = None  # type: ignore[assignment]
