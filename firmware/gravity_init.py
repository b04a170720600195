"""Initial bias while driving: the reference rate is that of gravity rotating in the accelerometer."""

from micropython import const
from pseudo_filter import mean_q14
from pseudo_init import PseudoInit, real
from small_float import number, times

_N_AXES = const(3)
_LOW_15 = const((1 << 15) - 1)
_LOW_14 = const((1 << 14) - 1)
_ONE_TURN = const(1 << 16)
_RATE_LIMIT = const((1 << 29) - 1)
_RAD = 0.017453292519943295
_G = 9.80665


def angle(y, x):
    """Return atan2(y, x) in 2^-16 turns, accurate to 2e-4 rad; 0 for (0, 0). |x|, |y| < 2^16."""
    a = x if x >= 0 else -x
    b = y if y >= 0 else -y
    if a < b:
        t = (a << 13) // b
    elif a:
        t = (b << 13) // a
    else:
        return 0
    # arctan on 0..1 by a polynomial of degree seven, coefficients in 2^-16 turns.
    s = t * t >> 13
    p = 1526 - (407 * s >> 13)
    p = (p * s >> 13) - 3350
    p = 10422 + (p * s >> 13)
    p = p * t + 4096 >> 13
    if a < b:
        p = (1 << 14) - p
    if x < 0:
        p = (1 << 15) - p
    return p if y >= 0 else -p


class GravitySums:
    """Means of the gyro and of the rotation rate of gravity over an interval, with equal parabolic weights.

    n: samples of an interval, 32 to 1024. arm_x, arm_y: lever arm, and `radius`, scaled as `add` needs them.
    turns_q14: mean rate of the last interval, 2^-16 turns per sample; turned: its angle, 2^-16 turns.

    With phi the angle about z, w its rate and w' its derivative, the specific force in the plane of the
    wheel is e^(-i phi) (g + i radius w') - w^2 arm + i w' arm. The direction of gravity is that of the force
    plus w^2 arm, less radius w' / g; the small term w' arm is neglected, and w' comes from the gyro through
    a filter over eight samples.
    The weights (k + 1)(n - 1 - k) of the n - 1 steps of phi yield the slope of a line fitted to phi; a step
    is the mean of the rates at its ends, so a gyro sample has the weights of its two steps.
    """

    def __init__(self, n, arm_x, arm_y, radius):
        self.n = n
        self._arm_x, self._arm_y, self._radius = arm_x, arm_y, radius
        self._shift = 0
        while n * n >> 2 + self._shift > 1 << 13:
            self._shift += 1
        self.weight = 0
        for k in range(n - 1):
            self.weight += (k + 1) * (n - 1 - k) >> self._shift
        self.turns_q14 = self.turned = 0
        self.mean_q14 = [0, 0, 0]
        self._high = [0, 0, 0, 0]
        self._low = [0, 0, 0, 0]
        self._smooth = 0
        self._known = False
        self.restart()

    def restart(self):
        """Discard the sums of the open interval."""
        for i in range(4):
            self._high[i] = self._low[i] = 0
        self.count = self._weight = self._angle = self._phase = 0

    def gap(self):
        """Discard the open interval: the rate before the next sample is unknown."""
        self._known = False
        self.restart()

    def add(self, values, at):
        """Add a row; return True when n are complete: the means are valid until the next row."""
        k = self.count
        spin = values[at + 2]
        if not self._known:
            self._smooth = spin << 4
            self._known = True
        # Difference from the smoothed rate, Q4: for constant w' it is eight times the change per sample.
        ahead = (spin << 4) - self._smooth
        self._smooth += ahead >> 3
        square = (spin >> 1) * (spin >> 1) >> 12
        x = values[at + 3] + (square * self._arm_x >> 12)
        y = values[at + 4] + (square * self._arm_y >> 12)
        if not (-_ONE_TURN < x < _ONE_TURN and -_ONE_TURN < y < _ONE_TURN):
            x = y = 0
        ahead = ahead if -(1 << 15) < ahead < 1 << 15 else 0
        phi = (ahead * self._radius >> 11) - angle(y, x)
        weight = (k + 1) * (self.n - 1 - k) >> self._shift
        high, low = self._high, self._low
        if k:
            step = (phi - self._phase + 0x8000 & 0xFFFF) - 0x8000
            self._angle += step
            product = step * self._weight
            high[3] += product >> 15
            low[3] += product & _LOW_15
        self._phase = phi
        both = self._weight + weight
        for axis in range(3):
            product = values[at + axis] * both
            high[axis] += product >> 15
            low[axis] += product & _LOW_15
        self._weight = weight
        self.count = k + 1
        if self.count < self.n:
            return False
        for axis in range(3):
            self.mean_q14[axis] = mean_q14(high[axis], low[axis], 2 * self.weight)
        self.turns_q14 = mean_q14(high[3], low[3], self.weight)
        self.turned = self._angle
        self.restart()
        return True


class GravityInit(PseudoInit):
    """`PseudoInit` with the rotation rate of gravity.

    Intervals of less than one turn are not used; a run without any other is refused (WHEEL_RESTS).

    A scale error of the gyro acts as a bias proportional to the rate: an error of 0.1 % in `gyro_scale_ppm`
    at 300 deg/s is a bias of 0.3 deg/s.
    """

    def averager(self, s, gyro_lsb_ndps, accel_lsb_ng):
        """Return (averager of an interval, variance of its mean over that of a sample); allocates."""
        n = max(s["bias_stretch"] or (1024 if s["rate_hz"] > 250 else 512), 32)
        step = gyro_lsb_ndps * 1e-9
        rate_hz = 1e9 / self.clock.period_ns
        x, y = s["arm_mm"] or (0, 0)
        # Accelerometer steps per (2^14 gyro steps)^2 and mm of lever arm; Q12 in the sums.
        arm = (step * _RAD) ** 2 * 0.001 / (accel_lsb_ng * 1e-9 * _G) * (1 << 26)
        # Tilt by the radius in 2^-16 turns, per gyro step of change per sample; Q4 in the sums.
        radius = s["wheel_radius_mm"] * 0.001 / _G * rate_hz * step * _RAD / (2 * 180 * _RAD) * (1 << 20)
        sums = GravitySums(n, _clipped(x * arm), _clipped(y * arm), _clipped(radius))
        # Gyro steps per 2^-16 turns/ns, with the scale error of the gyro, as 29 bits and a shift.
        scale = 360.0e9 / 65536 / step * (1 + s["gyro_scale_ppm"] * 1e-6)
        self._shift = 0
        while scale >= 1 << 29:
            scale *= 0.5
            self._shift -= 1
        while scale < 1 << 28:
            scale *= 2.0
            self._shift += 1
        self._scale = int(scale)
        phase = s["phase_mrad"] * 0.001 / (2 * 180 * _RAD) * 65536
        self._phase = real(phase * phase * 12.0 / n**3)
        return sums, 1.2 / n

    def is_usable(self, sums):
        """Return True after at least one turn; sets the rotation rate of gravity."""
        if -_ONE_TURN < sums.turned < _ONE_TURN:
            return False
        period_ns, shift = self.clock.period_ns, self._shift
        factor, remainder = self._scale // period_ns, self._scale % period_ns
        while factor < 1 << 27:
            remainder <<= 1
            factor = (factor << 1) + remainder // period_ns
            remainder %= period_ns
            shift += 1
        step = number(factor, -shift)
        self.doubt = times(self._phase, times(step, step))
        turns = sums.turns_q14 if sums.turns_q14 >= 0 else -sums.turns_q14
        high, low = turns >> 14, turns & _LOW_14
        f, g = factor >> 14, factor & _LOW_14
        top, middle = high * f, high * g + low * f
        if shift >= 28:
            self.rate_q14 = (top >> shift - 28) + (middle >> shift - 14)
        elif top >> shift:
            self.rate_q14 = _RATE_LIMIT
        else:
            self.rate_q14 = (top << 28 - shift) + (middle >> shift - 14)
        return True


def _clipped(value):
    return int(min(max(value, -8191.0), 8191.0))
