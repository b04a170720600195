"""Base class of the bias initialisers, which estimate the gyro bias at the start."""

from micropython import const
from wire import FILTER_STATE_INITIALISING, FILTER_STATE_TRACKING, FILTER_STATE_WAITING

MIN_SAMPLES = const(2000)
"""Least number of samples of an initialisation."""

MAX_BIAS_DPS = const(30)
"""Bound on the bias of every supported gyro."""

_N_AXES = const(3)


class BiasInitialiser:
    """Initial bias of the estimators, with its origin.

    bias_q14: bias when it was estimated, 2^-14 gyro steps; `now_q14` adds the warm-up since. samples: number
    of samples used, 0 for a bias from the settings. refused: Reason of the last failure (the previous bias
    stays), or 0. sigma_q12: 1 sigma of the bias, 2^-12 gyro steps, 0 if unknown.
    """

    def __init__(self):
        self.state = FILTER_STATE_WAITING
        self.samples = 0
        self.bias_q14 = [0] * _N_AXES
        self.variance_q8 = [0] * _N_AXES
        self.sigma_q12 = [0] * _N_AXES
        self.refused = 0
        self.shift_q18 = [0] * _N_AXES
        """Change by the warm-up since the estimate."""
        self._wanted = self._count = 0
        self._before = FILTER_STATE_WAITING

    def adopt(self, other):
        """Take over the estimate of another initialiser."""
        self.state = other.state if other.state != FILTER_STATE_INITIALISING else other._before
        self.samples = other.samples
        self.bias_q14, self.shift_q18 = other.bias_q14, other.shift_q18
        self.variance_q8, self.sigma_q12 = other.variance_q8, other.sigma_q12

    def give(self, axis, bias_q14):
        """Set the bias of an axis from the settings."""
        self.bias_q14[axis] = bias_q14
        self.shift_q18[axis] = self.variance_q8[axis] = self.sigma_q12[axis] = self.samples = 0
        self.state = FILTER_STATE_TRACKING

    def drift(self, axis, step_q18):
        """Add a step of the warm-up to the bias."""
        self.shift_q18[axis] += step_q18

    def now_q14(self, axis):
        """Return the present bias."""
        return self.bias_q14[axis] + (self.shift_q18[axis] >> 4)

    def gap(self):
        """Handle a gap before the next sample."""

    def _start(self, samples):
        self._wanted, self._count = samples, 0
        self.refused = 0
        if self.state != FILTER_STATE_INITIALISING:
            self._before = self.state
        self.state = FILTER_STATE_INITIALISING

    def _refuse(self, reason):
        self.refused = reason
        self.state = self._before
        return True
