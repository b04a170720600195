"""Confirms the first start of firmware that came over the air (`switch.py`), by a request of the host."""

import os
import sys
from time import ticks_add, ticks_diff, ticks_ms

from micropython import const
from wire import REBOOT_MODE_RUN

_FILES = ("/main.py", "/config.json")
_LIMIT_MS = const(120000)
"""Time from the first start until a request of the host must arrive."""


class Trial:
    """Watches the first start of a node, in place of its `commands` and `slow` until it is confirmed."""

    def __init__(self, node):
        self._node, self._commands, self._slow = node, node.commands, node.slow
        self._due_ms = ticks_add(ticks_ms(), _LIMIT_MS)
        node.commands = node.slow = self

    def handle(self, frame, received_us):
        """Confirm the first start, as the host reaches this firmware; then execute the request."""
        node = self._node
        node.commands, node.slow = self._commands, self._slow
        for name in _FILES:
            try:
                os.rename(name + ".new", name)
            except OSError:
                # The settings are unchanged.
                pass
        for name in ("radio", "radio.trial"):
            # An update needs this heap.
            sys.modules.pop(name, None)
        node.commands.handle(frame, received_us)

    def bias_given_up(self):
        """Do nothing: no initialisation is pending."""

    def use(self, values, first, count):
        """Pass samples to the detector of standstill, if the node has one."""
        if self._slow is not None:
            self._slow.use(values, first, count)

    def step(self, ms):
        """End the first start when its time is over."""
        if ticks_diff(ms, self._due_ms) >= 0:
            self._node.leave = REBOOT_MODE_RUN
        elif self._slow is not None:
            self._slow.step(ms)
