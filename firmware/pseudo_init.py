"""Initial bias by the pseudo-measurement: wheel at standstill, or on a table of known rate."""

from bias_initialiser import MAX_BIAS_DPS, BiasInitialiser
from micropython import const
from pseudo_filter import PseudoFilter
from small_float import integer, minus, number, over, plus, root, times
from wire import BIAS_KIND_REST, FILTER_STATE_TRACKING, REASON_WHEEL_RESTS, REASON_WHEEL_TURNS

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_N_AXES = const(3)
_ROW = const(6)
_PUT_LIMIT = const(1 << 27)


class PseudoInit(BiasInitialiser):
    """Bias by `PseudoFilter` over means of intervals: BIAS_KIND_REST or BIAS_KIND_TABLE.

    Its sigma is that of the filter, inflated where innovations exceed theirs (vibration), plus
    `gyro_scale_sigma_ppm` times the mean rate: a constant error, which averaging does not reduce.
    clock: a SampleClock, for its `period_ns`.
    """

    # At standstill `StaticInit` refuses a wheel that turns; the filter starts at the mean of the first
    # interval with its noise as sigma (from an initial error d it needs (d / s)^2 intervals to converge).
    # On a table it starts at the present bias with `bias_sigma_udps`; an error d across the axis of rotation
    # appears along it as d^2 / (2 |w|).

    def __init__(self, kind, settings, clock):
        super().__init__()
        self.filter = PseudoFilter()
        self.used = 0
        """Number of intervals used."""
        self.clock = clock
        self.rate_q14 = 0
        self.doubt = 0
        self._settings = settings
        self._guard: Any = None
        if kind == BIAS_KIND_REST:
            from static_init import StaticInit

            self._guard = StaticInit()
        self._sums: Any = None
        self._noise_q8 = self._limit_q16 = self._doubted = self._begun = 0
        self._mean_q14 = [0, 0, 0]

    def start(self, samples, gyro_lsb_ndps, accel_lsb_ng):
        """Start with MIN_SAMPLES <= samples <= 65535, from the present bias.

        Computes with floats and allocates, as its duration does not matter.
        """
        s = self._settings
        lsb_udps = gyro_lsb_ndps * 0.001
        noise = (s["noise_udps"] / lsb_udps) ** 2
        self._sums, share = self.averager(s, gyro_lsb_ndps, accel_lsb_ng)
        noise_of_mean = real(noise * share)
        start = noise_of_mean if self._guard is not None else real((s["bias_sigma_udps"] / lsb_udps) ** 2)
        self.filter.reset(start, noise_of_mean)
        self._begun = start
        self._doubted = real((s["gyro_scale_sigma_ppm"] * 1e-6) ** 2)
        for axis in range(_N_AXES):
            self._mean_q14[axis] = 0
            self.filter.bias_q16[axis] = self.now_q14(axis) << 2
        self._noise_q8 = min(int(noise * 256), (1 << 30) - 1)
        self._limit_q16 = min(int(MAX_BIAS_DPS * 1000000 / lsb_udps), (1 << 13) - 1) << 16
        if self._guard is not None:
            self._guard.start(samples, gyro_lsb_ndps, accel_lsb_ng)
        self.used = 0
        self._start(samples)

    def averager(self, s, gyro_lsb_ndps, accel_lsb_ng):
        """Return (averager of an interval, variance of its mean over that of a sample)."""
        n = s["bias_stretch"] or 16
        if self._guard is None:
            self.rate_q14 = min(s["table_rate_udps"] * 16384000 // gyro_lsb_ndps, (1 << 29) - 1)
        from mean_sums import MeanSums

        return MeanSums(n), 1.0 / n

    def drift(self, axis, step_q18):
        """Add a step of the warm-up to the bias."""
        super().drift(axis, step_q18)
        self.filter.bias_q16[axis] += step_q18 >> 2
        if self._guard is not None:
            self._guard.drift(axis, step_q18)

    def gap(self):
        """Handle a gap before the next sample."""
        if self._sums is not None:
            self._sums.gap()

    def update(self, values, first, count):
        """Add rows of six int16; return True at the end: in TRACKING, or refused with the state as before."""
        left = self._wanted - self._count
        count = count if count < left else left
        last = first + _ROW * count
        guard = self._guard
        if guard is not None and guard.update(values, first, count) and guard.refused:
            return self._refuse(guard.refused)
        for at in range(first, last, _ROW):
            if self._sums.add(values, at) and self.is_usable(self._sums):
                self._stretch(self._sums.mean_q14)
        self._count += count
        return self._count == self._wanted and self._finish()

    def is_usable(self, sums):
        """Return True if the interval is usable; sets `rate_q14` and its variance `doubt`."""
        return True

    def _stretch(self, mean_q14):
        self.used += 1
        for axis in range(_N_AXES):
            self._mean_q14[axis] += (mean_q14[axis] - self._mean_q14[axis]) // self.used
        if self.used > 1 or self._guard is None:
            self.filter.update(mean_q14, self.rate_q14, self.doubt)
            return
        for axis in range(_N_AXES):
            mean = mean_q14[axis]
            self.filter.set_bias(axis, (mean if -_PUT_LIMIT < mean < _PUT_LIMIT else 0) << 2)

    def _finish(self):
        if not self.used:
            return self._refuse(REASON_WHEEL_RESTS)
        bias = self.filter.bias_q16
        for axis in range(_N_AXES):
            if not -self._limit_q16 <= bias[axis] <= self._limit_q16:
                return self._refuse(REASON_WHEEL_TURNS)
        doubt = self._doubt()
        for axis in range(_N_AXES):
            self.bias_q14[axis] = bias[axis] + 2 >> 2
            self.shift_q18[axis] = 0
            self.sigma_q12[axis] = integer(root(self._variance(axis, doubt)), 12)
            self.variance_q8[axis] = self._noise_q8 if self._guard is None else self._guard.variance_q8[axis]
        self.samples = self._wanted
        self.state = FILTER_STATE_TRACKING
        return True

    def _doubt(self):
        """Return the relative variance of the rate by scale and by biases across the axis.

        Biases of variance p across the axis of rotation lengthen |G| by their squares over twice the rate.
        """
        square = longer = 0
        for axis in range(_N_AXES):
            mean, p = number(self._mean_q14[axis], -14), self.filter.variance(axis)
            square = plus(square, times(mean, mean))
            longer = plus(longer, times(p, p))
        if self._guard is not None or not square:
            return 0
        return plus(self._doubted, over(longer, times(square, plus(square, square))))

    def _variance(self, axis, doubt):
        """Return the variance of the bias of an axis, at most the initial one."""
        v, mean = self.filter.variance(axis), number(self._mean_q14[axis], -14)
        if integer(self.filter.surprise, 0) > self.used:
            v = over(times(v, self.filter.surprise), number(self.used, 0))
            if integer(plus(self._begun, minus(v)), 20) < 0:
                v = self._begun
        return plus(v, times(doubt, times(mean, mean)))


def real(x):
    """Convert a float above zero to a small float; allocates."""
    e = 0
    while x >= 1 << 29:
        x *= 0.5
        e += 1
    while 0 < x < 1 << 20:
        x *= 2.0
        e -= 1
    return number(int(x), e)
