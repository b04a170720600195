"""What every initialisation of the bias is: the bias at the start, and how it was found."""

from micropython import const
from wire import FILTER_STATE_INITIALISING, FILTER_STATE_TRACKING, FILTER_STATE_WAITING

LEAST_SAMPLES = const(2000)
"""Behind an initialisation."""

BIAS_DPS = const(30)
"""No gyro that the node knows has more."""

_AXES = const(3)


class BiasInitialiser:
    """The bias that filters begin with, and how it was found.

    bias_q14: as it was found; `now_q14` has the warm-up since. samples: behind it, 0 when it comes from the
    settings. refused: a Reason why the last attempt gave nothing (what was known before stays), or 0.
    sigma_q12: 1 sigma of the bias, 0 when it is not known.
    """

    def __init__(self):
        self.state = FILTER_STATE_WAITING
        self.samples = 0
        self.bias_q14 = [0] * _AXES
        self.variance_q8 = [0] * _AXES
        self.sigma_q12 = [0] * _AXES
        self.refused = 0
        self.moved_q18 = [0] * _AXES
        """By the warm-up, since the bias was found."""
        self._wanted = self._seen = 0
        self._before = FILTER_STATE_WAITING

    def adopt(self, other):
        """Goes on from what another initialisation knows."""
        self.state = other.state if other.state != FILTER_STATE_INITIALISING else other._before
        self.samples = other.samples
        self.bias_q14, self.moved_q18 = other.bias_q14, other.moved_q18
        self.variance_q8, self.sigma_q12 = other.variance_q8, other.sigma_q12

    def give(self, axis, bias_q14):
        """A bias from the settings."""
        self.bias_q14[axis] = bias_q14
        self.moved_q18[axis] = self.variance_q8[axis] = self.sigma_q12[axis] = self.samples = 0
        self.state = FILTER_STATE_TRACKING

    def drift(self, axis, step_q18):
        """The bias has moved by what the warm-up says."""
        self.moved_q18[axis] += step_q18

    def now_q14(self, axis):
        """The bias of this moment."""
        return self.bias_q14[axis] + (self.moved_q18[axis] >> 4)

    def gap(self):
        """Samples are missing before the next."""

    def _begin(self, samples):
        self._wanted, self._seen = samples, 0
        self.refused = 0
        if self.state != FILTER_STATE_INITIALISING:
            self._before = self.state
        self.state = FILTER_STATE_INITIALISING

    def _refuse(self, reason):
        self.refused = reason
        self.state = self._before
        return True
