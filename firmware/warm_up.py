"""The warm-up of the gyro, C1 (1 - e^(-t/T)), as the recursion of Barshan and Durrant-Whyte, eq. 6.

eps(k + 1) = T / (T + Ts) eps(k) + Ts / (T + Ts) (C1 + C2), with Ts = T / 1024 whatever T is. What is still to
come, e = C1 + C2 - eps, then shrinks by e / 1025 at each step: that much the bias moves, exactly, and C2 is
whatever bias the node began with. Against the exponential the recursion is late by at most 1.8e-4 of C1, and
what it moves by at once is C1 / 1025. Q18 gyro steps, |C1| below 2^11 steps; the end is missed by up to
2^-9 steps, where e / 1025 rounds to nothing.
"""

from time import ticks_add, ticks_diff

from micropython import const

_AXES = const(3)
_PARTS = const(1024)
_LONG_AGO = const(14)
"""Time constants after which it is over: e^-14 of 2^11 steps is below 2^-9."""


class WarmUp:
    """What the bias has moved by since power-on, and by how much it moves.

    c1_q18: (3,) C1 of each axis, within +-2^29; it is kept. time_constant_ms: T, 1000 or more. now_ms: ticks.
    age_ms: since power-on, -1: long ago.
    """

    def __init__(self, c1_q18, time_constant_ms, now_ms, age_ms):
        self.step_q18 = [0] * _AXES
        """What the last `turn` moved the bias by."""
        self._c1 = c1_q18
        self._left = list(c1_q18)
        self._step_ms, self._part = time_constant_ms // _PARTS, time_constant_ms % _PARTS
        self._late = 0
        self._next_ms = now_ms
        self._wait()
        if age_ms < 0 or age_ms // _LONG_AGO > time_constant_ms:
            self._left = [0] * _AXES
        else:
            for _ in range(age_ms * _PARTS // time_constant_ms):
                self._step()

    def turn(self, now_ms):
        """True when the bias has moved, by `step_q18`: at most once a call."""
        if ticks_diff(now_ms, self._next_ms) < 0:
            return False
        self._wait()
        self._step()
        return True

    def grown_q18(self, axis):
        """What the bias has moved by since power-on."""
        return self._c1[axis] - self._left[axis]

    def _wait(self):
        """The next step is T / 1024 later: whole milliseconds, with what is left of them carried on."""
        self._late += self._part
        self._next_ms = ticks_add(self._next_ms, self._step_ms + self._late // _PARTS)
        self._late %= _PARTS

    def _step(self):
        for axis in range(_AXES):
            left = self._left[axis]
            step = (left + 512) // (_PARTS + 1) if left >= 0 else -((512 - left) // (_PARTS + 1))
            self.step_q18[axis] = step
            self._left[axis] = left - step
