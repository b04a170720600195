"""When samples were taken: a phase-locked estimate in integers from when they were seen on the chip.

A look at the chip at `at_us` that shows sample k and not k + 1 says t(k) <= at_us < t(k) + period. While
these bounds hold, the estimate runs on its own; where it breaks one, it is moved to it, and the period leans
along. A look on time that finds its sample moves the estimate a little earlier: it feels for the edge.
Times are ticks modulo 2^30; every intermediate stays within +-2^30 for periods up to 0.1 s.
"""

from time import ticks_add, ticks_diff, ticks_us

from micropython import const

_ACQUIRE_US = const(400000)
"""The period is first measured over this time, without feedback."""
_ACQUIRE_LEAST = const(8)
_PATIENCE = const(7)
"""After this many looks and one, all on time, the estimate feels for the edge in steps of twice the size."""
_LOST_US = const(1000000)
"""After so long without a sample the lock is given up."""


class SampleClock:
    """t_us: time of the newest sample seen on the chip; period_ns: measured; index: its number, or -1."""

    def __init__(self):
        self.index = -1
        self.t_us = self._from_us = ticks_us()
        self._count = 0
        self.start(1000000)

    def start(self, period_ns):
        """Begins anew from a nominal period; `index` goes on."""
        self.locked = False
        self._fresh = True
        self._rephase = False
        self._t_ns = 0
        self._moved = self._chased = 0
        self._step_us = 1
        self._in_row = 0
        self._set_period(period_ns)

    def rephase(self):
        """The chip was configured again: its beat began anew, its period is the same."""
        self._rephase = True
        self._moved = self._chased = 0

    def _set_period(self, period_ns):
        self.period_ns = period_ns
        self.period_us = period_ns // 1000
        self._rest_ns = period_ns % 1000

    def ahead_us(self, samples):
        """Time of the sample that comes `samples` after the newest one; negative: before it."""
        return ticks_add(self.t_us, samples * self.period_us + (self._t_ns + samples * self._rest_ns) // 1000)

    def late_us(self, at_us, samples):
        """How long at `at_us` the last of `samples` new ones has been there: 0 to a period, by the clock.

        0 until the clock is locked.
        """
        if not self.locked or self._rephase:
            return 0
        return ticks_diff(at_us, self.ahead_us(samples))

    def skipped(self, at_us, samples):
        """How many more than `samples` new ones must have been taken up to `at_us`, by the clock."""
        late = ticks_diff(at_us, self.ahead_us(samples))
        if not self.locked:
            # Both times are those of looks, and the period is the nominal one: to the nearest.
            late += self.period_us >> 1
        else:
            late += self._chased
        if self._fresh or late < self.period_us:
            return 0
        return late // self.period_us

    def interrupted(self):
        """Samples were lost that only the clock can count: a measurement of the period begins anew."""
        if not self.locked:
            self._count = -1

    def seen(self, at_us, samples, on_time):
        """At `at_us`, exactly `samples` new ones were there; on_time: the first look since one was due."""
        self.index += samples
        if self._fresh:
            if samples:
                self._fresh = False
                self.t_us, self._t_ns = at_us, 0
                self._from_us, self._count = at_us, 0
            return
        if self._rephase:
            if samples:
                self._rephase = False
                self.t_us, self._t_ns = at_us, 0
                self._step_us = self.period_us >> 5
            return
        if not self.locked:
            self._acquire(at_us, samples)
            return
        if samples:
            if samples > 1 and self._chased:
                # It was not the beat that had become slower.
                self.t_us = ticks_add(self.t_us, -self._chased)
                self._set_period(self.period_ns - self._chased)
            self._chased = 0
            self.t_us = self.ahead_us(samples)
            self._t_ns = (self._t_ns + samples * self._rest_ns) % 1000
        early = ticks_diff(at_us, self.t_us)
        if early < 0:
            move = early
        elif early > self.period_us:
            move = early - self.period_us
            least = (self.period_us >> 9) + 1
            self._step_us = self._step_us >> 1 if self._step_us > 2 * least else least
            self._in_row = 0
        elif on_time and samples and early < self.period_us >> 2:
            move = -self._step_us
            self._in_row += 1
            if self._in_row & _PATIENCE == 0 and self._step_us < self.period_us >> 5:
                # The edge runs away: the chip has become faster than the period says.
                self._step_us <<= 1
        else:
            return
        # A look that the processor delayed breaks a bound by chance: no single one may move much.
        limit = (self.period_us >> 5) + 4
        move = limit if move > limit else (-limit if move < -limit else move)
        if not samples and move > 0:
            if self._chased > self.period_us >> 3:
                # The chip is silent: there is no beat to follow.
                return
            self._chased += move
        half = self.period_us >> 1
        if -half < self._moved + move < half:
            self._moved += move
            self.t_us = ticks_add(self.t_us, move)
            self._set_period(self.period_ns + move)

    def batch_began(self):
        """A batch takes its time stamp now: within one, moves are bounded so that time never runs back."""
        self._moved = 0

    def _acquire(self, at_us, samples):
        if not samples:
            return
        self.t_us, self._t_ns = at_us, 0
        elapsed = ticks_diff(at_us, self._from_us)
        if self._count < 0 or elapsed > _LOST_US:
            self._from_us, self._count = at_us, 0
            return
        self._count += samples
        if self._count >= _ACQUIRE_LEAST:
            self._set_period(elapsed * 1000 // self._count)
            self.locked = elapsed >= _ACQUIRE_US
            self._step_us = self.period_us >> 5
