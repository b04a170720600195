"""Initial bias from the mean of the gyro at standstill."""

from bias_initialiser import MAX_BIAS_DPS, BiasInitialiser
from micropython import const
from wire import FILTER_STATE_TRACKING, REASON_WHEEL_TURNS

_N_AXES = const(3)
_ROW = const(6)
_LOW_10 = const((1 << 10) - 1)
_LOW_20 = const((1 << 20) - 1)


class StaticInit(BiasInitialiser):
    """Mean and variance of the gyro over at least 2000 samples at standstill.

    Motion is refused: a gyro mean or sample beyond the bound on a bias (30 deg/s), a gyro variance above
    (1 deg/s)^2, or gravity rotating in the node (accelerometer variance above (0.02 g)^2).
    """

    def __init__(self):
        super().__init__()
        self._reference = [0] * _ROW
        self._sum = [0] * _ROW
        self._square_high = [0] * _ROW
        self._square_low = [0] * _ROW
        self._limit = [0] * _ROW
        self._variance_limit = [0] * _ROW
        self._start_shift_q18 = [0] * _N_AXES
        self._mean_q14 = [0] * _N_AXES
        self._variance_q8 = [0] * _N_AXES

    def start(self, samples, gyro_lsb_ndps, accel_lsb_ng):
        """Start with MIN_SAMPLES <= samples <= 65535."""
        for i in range(_ROW):
            self._sum[i] = self._square_high[i] = self._square_low[i] = 0
            if i < _N_AXES:
                self._start_shift_q18[i] = self.shift_q18[i]
                self._limit[i] = 1000000000 // gyro_lsb_ndps * MAX_BIAS_DPS
                self._variance_limit[i] = (1000000000 // gyro_lsb_ndps) ** 2
            else:
                self._limit[i] = 500000000 // accel_lsb_ng
                self._variance_limit[i] = (20000000 // accel_lsb_ng) ** 2
        self._start(samples)

    def update(self, values, first, count):
        """Add rows of six int16; return True at the end: in TRACKING, or refused with the state as before."""
        for at in range(first, first + _ROW * count, _ROW):
            if self._count == 0:
                for i in range(_ROW):
                    self._reference[i] = values[at + i]
            for i in range(_ROW):
                d = values[at + i] - self._reference[i]
                if d > self._limit[i] or d < -self._limit[i]:
                    return self._refuse(REASON_WHEEL_TURNS)
                self._sum[i] += d
                square = self._square_low[i] + d * d
                self._square_high[i] += square >> 20
                self._square_low[i] = square & _LOW_20
            self._count += 1
            if self._count == self._wanted:
                return self._finish()
        return False

    def _finish(self):
        n = self._wanted
        for i in range(_ROW):
            mean, part = self._sum[i] // n, self._sum[i] % n
            # Mean square by long division of the double word: ten bits, ten bits, then eight more.
            high, remainder = self._square_high[i] // n, self._square_high[i] % n
            remainder = (remainder << 10) + (self._square_low[i] >> 10)
            middle, remainder = remainder // n, remainder % n
            remainder = (remainder << 10) + (self._square_low[i] & _LOW_10)
            low, remainder = remainder // n, remainder % n
            variance = (high << 20) + (middle << 10) + low - mean * mean
            # The mean was truncated; with its fraction f, mean^2 lacks 2 mean f + f^2.
            part_q8 = (part << 8) // n
            cut_q8 = 2 * mean * part_q8 + (part_q8 * part_q8 >> 8)
            if variance - (cut_q8 >> 8) > self._variance_limit[i]:
                return self._refuse(REASON_WHEEL_TURNS)
            if i < _N_AXES:
                if not -self._limit[i] <= self._reference[i] + mean <= self._limit[i]:
                    return self._refuse(REASON_WHEEL_TURNS)
                variance = (variance << 8) + (remainder << 8) // n - cut_q8
                self._variance_q8[i] = variance if variance > 0 else 0
                self._mean_q14[i] = ((self._reference[i] + mean) << 14) + (part << 14) // n
        for i in range(_N_AXES):
            # The mean belongs to the middle of the interval: add half of the warm-up during it.
            self.bias_q14[i] = self._mean_q14[i] + (self.shift_q18[i] - self._start_shift_q18[i] >> 5)
            self.shift_q18[i] = 0
            self.variance_q8[i] = variance = self._variance_q8[i]
            if variance < 1 << 17:
                self.sigma_q12[i] = _root((variance << 12) // n << 4)
            else:
                self.sigma_q12[i] = _root(variance // n << 4) << 6
        self.samples = n
        self.state = FILTER_STATE_TRACKING
        return True


def _root(square):
    """Return the integer square root."""
    if not square:
        return 0
    guess = 1 << 15
    while True:
        better = guess + square // guess >> 1
        if better >= guess:
            return guess
        guess = better
