"""Mean of the gyro over a fixed number of samples, for a wheel at standstill or on a rate table."""

from micropython import const
from pseudo_filter import mean_q14

_LOW_15 = const((1 << 15) - 1)


class MeanSums:
    """Means over n samples, 1 <= n <= 1024."""

    def __init__(self, n):
        self.n = n
        self.count = 0
        self.mean_q14 = [0, 0, 0]
        self._sum = [0, 0, 0]

    def gap(self):
        """Ignore a gap: it does not bias a mean."""

    def restart(self):
        """Discard the sums of the open interval."""
        self.count = self._sum[0] = self._sum[1] = self._sum[2] = 0

    def add(self, values, at):
        """Add a row; return True when n are complete: `mean_q14` is valid until the next row."""
        total = self._sum
        total[0] += values[at]
        total[1] += values[at + 1]
        total[2] += values[at + 2]
        self.count += 1
        if self.count < self.n:
            return False
        for axis in range(3):
            self.mean_q14[axis] = mean_q14(total[axis] >> 15, total[axis] & _LOW_15, self.n)
        self.restart()
        return True
