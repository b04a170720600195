"""Time stamps of samples by interval arithmetic in integers: each poll narrows a window of possible times.

A poll at a moment between `early` and `late` that shows sample k and not k + 1 implies
    t(k) <= late,  t(k) > early - period
and the window is intersected with that. From sample to sample it advances by the period and widens by the
uncertainty of the period, which follows from two windows some seconds apart. A poll at the middle of the
window halves it, whatever it shows: `aim_us` returns that moment. If the intersection is empty, the sample
rate has changed. Times are ticks modulo 2^30; intermediates stay within +-2^30 for periods up to 0.1 s.
"""

from time import ticks_add, ticks_diff, ticks_us

from micropython import const

_NARROW_NS = const(60000)
"""Half width of a window that is narrow enough: polls then come after its end."""
_JITTER_NS = const(5000)
"""Jitter allowed for the chip's sampling instants."""
_CONTRADICTION_NS = const(20000)
"""Polls may contradict each other by this much before the sample rate is in doubt."""
_UNKNOWN_NS = const(1 << 28)
_UNKNOWN_US = const(65535)
_CLIP_US = const(250000)
"""Polls further than this from the expected sample count as if they were this far."""
_BASELINE_US = const(2000000)
"""The period is measured between windows this far apart."""


class SampleClock:
    """Estimates time and period of samples. t_us, index: time and number of the newest one.

    period_ns: measured period. half_ns: half the window about t_us. locked: the window is known to an eighth
    of a period and the period to 1 / 32.
    """

    def __init__(self):
        self.index = -1
        self.t_us = self._mark_us = self._empty_us = ticks_us()
        self._t_ns = self._mark_ns = self._mark_half_ns = self._count = 0
        self.start(1000000)

    def start(self, period_ns):
        """Reset to a nominal period, accurate to an eighth; `index` continues."""
        self.locked = False
        self._started = False
        self._doubt_ns = period_ns >> 3
        self._set_period(period_ns)
        self.rephase()

    def rephase(self):
        """Reset the phase: the chip was configured again with the same period."""
        self._no_phase = True
        self._empty_us = ticks_us()
        self.half_ns = _UNKNOWN_NS

    def _set_period(self, period_ns):
        self.period_ns = period_ns
        self.period_us = period_ns // 1000
        self._rest_ns = period_ns % 1000

    def ahead_us(self, samples):
        """Return the time of the sample `samples` after the newest one; negative: before it."""
        return ticks_add(self.t_us, samples * self.period_us + (self._t_ns + samples * self._rest_ns) // 1000)

    def half_ahead_ns(self, samples):
        """Return half the window of the sample `samples` after the newest one."""
        if samples > (_UNKNOWN_NS - self.half_ns) // self._doubt_ns:
            return _UNKNOWN_NS
        return self.half_ns + samples * self._doubt_ns

    def aim_us(self, samples):
        """Return when to poll for the sample `samples` ahead: amid a wide window, or after a narrow one."""
        half_ns = self.half_ahead_ns(samples)
        at_us = self.ahead_us(samples)
        return at_us if half_ns > _NARROW_NS else ticks_add(at_us, (half_ns + _JITTER_NS) // 1000)

    def is_wide(self):
        """Return True while the window is so wide that the next sample should be polled separately."""
        return self._no_phase or self.half_ahead_ns(1) > 2 * _NARROW_NS

    def bound_us(self):
        """Return the bound on the error of the newest time stamp; 65535 while it is unknown."""
        half_us = self.half_ns // 1000 + 1
        return half_us if self.locked and half_us < _UNKNOWN_US else _UNKNOWN_US

    def late_us(self, at_us, samples):
        """Return the age at `at_us` of the last of `samples` new ones, 0 to a period if none is missing.

        0 until the clock is locked.
        """
        if not self.locked or self._no_phase:
            return 0
        return ticks_diff(at_us, self.ahead_us(samples))

    def skipped(self, at_us, samples):
        """Return how many samples were skipped besides `samples` new ones, the last at about `at_us`."""
        if not self._started:
            return 0
        late = ticks_diff(at_us, self.ahead_us(samples)) + (self.period_us >> 1)
        return late // self.period_us if late > 0 else 0

    def is_certain(self, early_us, late_us, samples):
        """Return True if no sample can lie between the two times, `samples` or more ahead."""
        since_us = ticks_diff(early_us, self.ahead_us(samples))
        if self._no_phase or since_us < 0:
            return False
        lost = since_us // self.period_us
        half_us = self.half_ahead_ns(samples + lost) // 1000
        since_us %= self.period_us
        return since_us > half_us and since_us + ticks_diff(late_us, early_us) + half_us < self.period_us

    def identifies(self, early_us, late_us):
        """Return True if the index of a sample taken between the two times is unambiguous."""
        if self._no_phase:
            return True
        half_ns = self.half_ahead_ns(1)
        return (
            half_ns < self.period_ns >> 1
            and ticks_diff(late_us, early_us) * 500 < (self.period_ns >> 1) - half_ns
        )

    def is_before(self, at_us, samples):
        """Return True if the sample `samples` ahead cannot have been taken by `at_us`."""
        half_us = self.half_ahead_ns(samples) // 1000
        return not self._no_phase and ticks_diff(at_us, self.ahead_us(samples)) < -half_us

    def gap(self, lost):
        """Restart the measurement of the period if the count of `lost` samples may be wrong."""
        if lost > (self.period_ns >> 2) // self._doubt_ns:
            self._mark()

    def update(self, early_us, late_us, samples):
        """Update with a poll: at a moment between `early_us` and `late_us` there were `samples` new ones."""
        self.index += samples
        if not samples:
            self._empty_us = early_us
            if self._no_phase:
                return
        elif self._no_phase:
            self._start(late_us, samples)
        else:
            self.half_ns = self.half_ahead_ns(samples)
            self.t_us = self.ahead_us(samples)
            self._t_ns = (self._t_ns + samples * self._rest_ns) % 1000
            self._count += samples
        low, high = -self.half_ns, self.half_ns
        late_ns = self._offset_ns(late_us) + _JITTER_NS
        early_ns = self._offset_ns(early_us) - self.period_ns - self._doubt_ns - _JITTER_NS
        if samples == 1:
            # The poll before may have shown that it had not been taken yet.
            empty_ns = self._offset_ns(self._empty_us) - _JITTER_NS
            early_ns = empty_ns if empty_ns > early_ns else early_ns
        if late_ns < high:
            high = late_ns
        if early_ns > low:
            low = early_ns
        if low > high:
            # Without a sample the chip may be silent: the rate is not in doubt.
            if samples:
                self._lose_phase(low, high, late_ns == high)
            return
        self._move(low + high >> 1)
        self.half_ns = high - low + 1 >> 1
        if samples:
            self._measure()

    def _offset_ns(self, at_us):
        """Return the time from the newest sample to `at_us`."""
        after_us = ticks_diff(at_us, self.t_us)
        if after_us > _CLIP_US:
            after_us = _CLIP_US
        elif after_us < -_CLIP_US:
            after_us = -_CLIP_US
        return after_us * 1000 - self._t_ns

    def _move(self, by_ns):
        by_ns += self._t_ns
        self.t_us = ticks_add(self.t_us, by_ns // 1000)
        self._t_ns = by_ns % 1000

    def _start(self, late_us, samples):
        """Start the window with a first sample: since the last poll without one, within the last period."""
        self._no_phase = False
        self._started = True
        since_us = ticks_diff(late_us, self._empty_us)
        longest_us = self.period_us + self._doubt_ns // 1000
        if samples > 1 or not 0 < since_us < longest_us:
            since_us = longest_us
        self.t_us, self._t_ns = ticks_add(late_us, -(since_us >> 1)), 0
        self.half_ns = since_us * 500 + 1000
        self._mark()

    def _mark(self):
        """Start a measurement of the period at the newest sample."""
        self._mark_us, self._mark_ns, self._mark_half_ns = self.t_us, self._t_ns, self.half_ns
        self._count = 0

    def _measure(self):
        """Estimate the period from this window and the marked one."""
        count = self._count
        if not count:
            return
        doubt_ns = (self.half_ns + self._mark_half_ns) // count + (self.period_ns >> 17) + 1
        passed_us = ticks_diff(self.t_us, self._mark_us)
        if doubt_ns < self._doubt_ns:
            self._doubt_ns = doubt_ns
            rest_ns = passed_us % count * 1000 + self._t_ns - self._mark_ns
            self._set_period(passed_us // count * 1000 + rest_ns // count)
        self._lock()
        if passed_us > _BASELINE_US:
            # The rate drifts with temperature: the uncertainty grows by half per baseline.
            self._doubt_ns += (self._doubt_ns >> 1) + 1
            self._mark()

    def _lock(self):
        self.locked = self.half_ns < self.period_ns >> 3 and self._doubt_ns < self.period_ns >> 5

    def _lose_phase(self, low, high, early):
        """Handle a sample taken before (early) or after its window: the rate changed or a poll was wrong.

        The window moves to the poll, as wide as before or as the distance, and the period is uncertain as if
        the distance had accumulated over eight samples.
        """
        missed_ns = low - high
        half_ns = self.half_ns
        if missed_ns < _CONTRADICTION_NS:
            self._move(low + high >> 1)
            self.half_ns = missed_ns + _JITTER_NS
            return
        if half_ns < missed_ns:
            half_ns = missed_ns
        if half_ns > self.period_ns >> 1:
            half_ns = self.period_ns >> 1
        self._move(high - half_ns if early else low + half_ns)
        self.half_ns = half_ns
        doubt_ns = (missed_ns >> 3) + (self._doubt_ns << 1)
        self._doubt_ns = doubt_ns if doubt_ns < self.period_ns >> 3 else self.period_ns >> 3
        self._lock()
        self._mark()
