"""A fake odometer that is much slower than the samples arrive."""

import time

from hubodo.ingest.live.odometer import Odometer


class FakeSlowOdometer(Odometer):
    """An odometer that blocks the interpreter for `busy_s` at each of its first `times` blocks."""

    busy_s, times = 1.0, 2

    def handle(self, block):
        if self.times > 0:
            self.times -= 1
            end = time.monotonic() + self.busy_s
            while time.monotonic() < end:
                pass
        return super().handle(block)
