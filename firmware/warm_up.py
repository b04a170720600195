"""Warm-up drift of the gyro, C1 (1 - e^(-t/T)), by the recursion of Barshan and Durrant-Whyte, eq. 6.

eps(k + 1) = T / (T + Ts) eps(k) + Ts / (T + Ts) (C1 + C2), with Ts = T / 1024. The remaining drift
e = C1 + C2 - eps shrinks by e / 1025 per step, and the bias changes by that amount; C2 is the bias at
power-on. The recursion lags the exponential by at most 1.8e-4 C1; its largest step is C1 / 1025. Q18 gyro
steps, |C1| < 2^11 steps; up to 2^-9 steps remain at the end, where e / 1025 rounds to zero.
"""

from time import ticks_add, ticks_diff

from micropython import const

_N_AXES = const(3)
_STEPS_PER_T = const(1024)
_COMPLETE_T = const(14)
"""Time constants until the drift is complete: 2^11 e^-14 steps are below 2^-9."""


class WarmUp:
    """Warm-up drift of three axes since power-on.

    c1_q18: (3,) C1 of each axis, within +-2^29; not copied. time_constant_ms: T, at least 1000.
    now_ms: ticks. age_ms: time since power-on, -1: the gyro is warm.
    """

    def __init__(self, c1_q18, time_constant_ms, now_ms, age_ms):
        self.step_q18 = [0] * _N_AXES
        """Change of the bias by the last `step`."""
        self._c1 = c1_q18
        self._left = list(c1_q18)
        self._step_ms, self._part = time_constant_ms // _STEPS_PER_T, time_constant_ms % _STEPS_PER_T
        self._late = 0
        self._next_ms = now_ms
        self._wait()
        if age_ms < 0 or age_ms // _COMPLETE_T > time_constant_ms:
            self._left = [0] * _N_AXES
        else:
            for _ in range(age_ms * _STEPS_PER_T // time_constant_ms):
                self._step()

    def step(self, now_ms):
        """Make a step if one is due; return True if so, its size in `step_q18`."""
        if ticks_diff(now_ms, self._next_ms) < 0:
            return False
        self._wait()
        self._step()
        return True

    def drift_q18(self, axis):
        """Return the drift of an axis since power-on."""
        return self._c1[axis] - self._left[axis]

    def _wait(self):
        """Set the time of the next step T / 1024 later, in ms; the fraction is carried over."""
        self._late += self._part
        self._next_ms = ticks_add(self._next_ms, self._step_ms + self._late // _STEPS_PER_T)
        self._late %= _STEPS_PER_T

    def _step(self):
        for axis in range(_N_AXES):
            left = self._left[axis]
            step = (left + 512) // (_STEPS_PER_T + 1) if left >= 0 else -((512 - left) // (_STEPS_PER_T + 1))
            self.step_q18[axis] = step
            self._left[axis] = left - step
