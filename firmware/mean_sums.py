"""Plain means of the gyro over stretches of samples, for a wheel at rest or a table."""

from micropython import const
from pseudo_init import mean_q14

_LOW_15 = const((1 << 15) - 1)


class MeanSums:
    """Plain means over n samples, 1 <= n <= 1024."""

    def __init__(self, n):
        self.n = n
        self.count = 0
        self.mean_q14 = [0, 0, 0]
        self._sum = [0, 0, 0]

    def gap(self):
        """A mean bears it."""

    def restart(self):
        """Forgets the open stretch."""
        self.count = self._sum[0] = self._sum[1] = self._sum[2] = 0

    def take(self, values, at):
        """Takes a row; True when a stretch is full, its means in `mean_q14` until the next row."""
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
