"""When samples were taken, in integers: the window in which the newest one lies, narrowed by each look.

A look at some moment between `early` and `late` that shows sample k and not k + 1 says
    t(k) <= late,  t(k) > early - period
and the window is cut to that. From sample to sample it moves on by the period and widens by the doubt of it,
which is what two windows, some seconds apart, leave open. A look at the middle of the window halves it,
whatever it finds: `aim_us` says when that is. Where a look leaves no window at all, the beat has changed.
Times are ticks modulo 2^30; every intermediate stays within +-2^30 for periods up to 0.1 s.
"""

from time import ticks_add, ticks_diff, ticks_us

from micropython import const

_FINE_NS = const(60000)
"""A window of twice this is narrow enough: looks then come when the sample is surely there."""
_JITTER_NS = const(5000)
"""How far samples may stand off an even beat."""
_SLIP_NS = const(20000)
"""Looks may contradict each other by so much before the beat is doubted."""
_NEVER_NS = const(1 << 28)
_UNKNOWN_US = const(65535)
_FAR_US = const(250000)
"""A look further than this from where its sample is expected says no more than one this far."""
_BASELINE_US = const(2000000)
"""The period is measured between windows so far apart."""


class SampleClock:
    """t_us: time of the newest sample, amid its window; period_ns: measured; index: its number, or -1.

    half_ns: half of the window. locked: whether window and period are known to an eighth of a period and to
    1 / 32.
    """

    def __init__(self):
        self.index = -1
        self.t_us = self._mark_us = self._empty_us = ticks_us()
        self._t_ns = self._mark_ns = self._mark_half_ns = self._count = 0
        self.start(1000000)

    def start(self, period_ns):
        """Begins anew from a nominal period, true to an eighth; `index` goes on."""
        self.locked = False
        self._began = False
        self._doubt_ns = period_ns >> 3
        self._set_period(period_ns)
        self.rephase()

    def rephase(self):
        """The chip was configured again: its beat began anew, its period is the same."""
        self._fresh = True
        self._empty_us = ticks_us()
        self.half_ns = _NEVER_NS

    def _set_period(self, period_ns):
        self.period_ns = period_ns
        self.period_us = period_ns // 1000
        self._rest_ns = period_ns % 1000

    def ahead_us(self, samples):
        """Time of the sample that comes `samples` after the newest one; negative: before it."""
        return ticks_add(self.t_us, samples * self.period_us + (self._t_ns + samples * self._rest_ns) // 1000)

    def half_ahead_ns(self, samples):
        """Half the window of the sample that comes `samples` after the newest one."""
        if samples > (_NEVER_NS - self.half_ns) // self._doubt_ns:
            return _NEVER_NS
        return self.half_ns + samples * self._doubt_ns

    def aim_us(self, samples):
        """When to look for the sample `samples` ahead: amid its window while that is wide, else behind it."""
        half_ns = self.half_ahead_ns(samples)
        at_us = self.ahead_us(samples)
        return at_us if half_ns > _FINE_NS else ticks_add(at_us, (half_ns + _JITTER_NS) // 1000)

    def wide(self):
        """Whether the next sample is worth a look of its own."""
        return self._fresh or self.half_ahead_ns(1) > 2 * _FINE_NS

    def bound_us(self):
        """The time of the newest sample is known to +- this; 65535 when it is not."""
        half_us = self.half_ns // 1000 + 1
        return half_us if self.locked and half_us < _UNKNOWN_US else _UNKNOWN_US

    def late_us(self, at_us, samples):
        """How long at `at_us` the last of `samples` new ones has been there: 0 to a period, by the clock.

        0 until the clock is locked.
        """
        if not self.locked or self._fresh:
            return 0
        return ticks_diff(at_us, self.ahead_us(samples))

    def skipped(self, at_us, samples):
        """How many more than `samples` new ones must have been taken, when the last came about `at_us`."""
        if not self._began:
            return 0
        late = ticks_diff(at_us, self.ahead_us(samples)) + (self.period_us >> 1)
        return late // self.period_us if late > 0 else 0

    def sure(self, early_us, late_us, samples):
        """Whether no sample can have come between the two, with `samples` or more behind it by then."""
        since_us = ticks_diff(early_us, self.ahead_us(samples))
        if self._fresh or since_us < 0:
            return False
        lost = since_us // self.period_us
        half_us = self.half_ahead_ns(samples + lost) // 1000
        since_us %= self.period_us
        return since_us > half_us and since_us + ticks_diff(late_us, early_us) + half_us < self.period_us

    def tells(self, early_us, late_us):
        """Whether a sample that came between the two can only be one of a beat: it has its number then."""
        if self._fresh:
            return True
        half_ns = self.half_ahead_ns(1)
        return (
            half_ns < self.period_ns >> 1
            and ticks_diff(late_us, early_us) * 500 < (self.period_ns >> 1) - half_ns
        )

    def before(self, at_us, samples):
        """Whether the sample `samples` ahead cannot have come by `at_us`."""
        half_us = self.half_ahead_ns(samples) // 1000
        return not self._fresh and ticks_diff(at_us, self.ahead_us(samples)) < -half_us

    def interrupted(self, lost):
        """So many samples were lost: if the clock may have miscounted them, it measures its period anew."""
        if lost > (self.period_ns >> 2) // self._doubt_ns:
            self._mark()

    def seen(self, early_us, late_us, samples):
        """Between `early_us` and `late_us` there was a moment at which just `samples` new ones were there."""
        self.index += samples
        if not samples:
            self._empty_us = early_us
            if self._fresh:
                return
        elif self._fresh:
            self._begin(late_us, samples)
        else:
            self.half_ns = self.half_ahead_ns(samples)
            self.t_us = self.ahead_us(samples)
            self._t_ns = (self._t_ns + samples * self._rest_ns) % 1000
            self._count += samples
        low, high = -self.half_ns, self.half_ns
        late_ns = self._after_ns(late_us) + _JITTER_NS
        early_ns = self._after_ns(early_us) - self.period_ns - self._doubt_ns - _JITTER_NS
        if samples == 1:
            # The look before may have shown that it was still to come.
            empty_ns = self._after_ns(self._empty_us) - _JITTER_NS
            early_ns = empty_ns if empty_ns > early_ns else early_ns
        if late_ns < high:
            high = late_ns
        if early_ns > low:
            low = early_ns
        if low > high:
            # Without a sample the chip may as well be silent: there is no beat to follow.
            if samples:
                self._break(low, high, late_ns == high)
            return
        self._move(low + high >> 1)
        self.half_ns = high - low + 1 >> 1
        if samples:
            self._measure()

    def _after_ns(self, at_us):
        """How far `at_us` is behind the newest sample."""
        after_us = ticks_diff(at_us, self.t_us)
        if after_us > _FAR_US:
            after_us = _FAR_US
        elif after_us < -_FAR_US:
            after_us = -_FAR_US
        return after_us * 1000 - self._t_ns

    def _move(self, by_ns):
        by_ns += self._t_ns
        self.t_us = ticks_add(self.t_us, by_ns // 1000)
        self._t_ns = by_ns % 1000

    def _begin(self, late_us, samples):
        """The first sample of a beat: since the last look without one, and within the last period."""
        self._fresh = False
        self._began = True
        since_us = ticks_diff(late_us, self._empty_us)
        longest_us = self.period_us + self._doubt_ns // 1000
        if samples > 1 or not 0 < since_us < longest_us:
            since_us = longest_us
        self.t_us, self._t_ns = ticks_add(late_us, -(since_us >> 1)), 0
        self.half_ns = since_us * 500 + 1000
        self._mark()

    def _mark(self):
        """A measurement of the period begins at the newest sample."""
        self._mark_us, self._mark_ns, self._mark_half_ns = self.t_us, self._t_ns, self.half_ns
        self._count = 0

    def _measure(self):
        """What this window and the marked one say of the period."""
        count = self._count
        if not count:
            return
        doubt_ns = (self.half_ns + self._mark_half_ns) // count + (self.period_ns >> 17) + 1
        passed_us = ticks_diff(self.t_us, self._mark_us)
        if doubt_ns < self._doubt_ns:
            self._doubt_ns = doubt_ns
            rest_ns = passed_us % count * 1000 + self._t_ns - self._mark_ns
            self._set_period(passed_us // count * 1000 + rest_ns // count)
        self._judge()
        if passed_us > _BASELINE_US:
            # The beat wanders with temperature: what is known of it ages.
            self._doubt_ns += (self._doubt_ns >> 1) + 1
            self._mark()

    def _judge(self):
        self.locked = self.half_ns < self.period_ns >> 3 and self._doubt_ns < self.period_ns >> 5

    def _break(self, low, high, early):
        """The sample came before (early) or after its window: the beat has changed, or a look was wrong.

        The window goes where the look says, as wide as it was or as far as it was missed, and the period is
        in doubt as if that had come about in eight samples.
        """
        missed_ns = low - high
        half_ns = self.half_ns
        if missed_ns < _SLIP_NS:
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
        self._judge()
        self._mark()
