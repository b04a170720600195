"""Slip schedule: which wheels slip in which windows, for a replay or a second pass."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class SlipSchedule:
    """Slipping wheels and additional speed variance, by window.

    Attributes
    ----------
    n_wheels : number of wheels.
    slipping : for each wheel whether it slips, by window number; windows without slip are not in it.
    speed_variance : (m/s)², added to the variance of the speed before a window, by window number.
    """

    n_wheels: int
    slipping: dict[int, tuple[bool, ...]] = field(default_factory=dict)
    speed_variance: dict[int, float] = field(default_factory=dict)

    def mark(self, wheel: int, numbers: range, slipping: bool = True) -> None:
        """Set whether a wheel slips in these windows."""
        for number in numbers:
            flags = list(self.slipping_wheels(number))
            flags[wheel] = slipping
            if any(flags):
                self.slipping[number] = tuple(flags)
            else:
                self.slipping.pop(number, None)

    def inflate_speed(self, numbers: range, square: float) -> None:
        """Distribute a squared speed error, (m/s)², that showed at the end of these windows.

        The error arose at an unknown time, so every window gets the same share: a random walk. Between both
        ends that is a Brownian bridge, with the variance of a jump at a uniformly distributed time.
        """
        for number in numbers:
            self.speed_variance[number] = self.speed_variance.get(number, 0.0) + square / len(numbers)

    def count_windows(self, wheel: int) -> int:
        """Return the number of windows in which a wheel slips."""
        return sum(flags[wheel] for flags in self.slipping.values())

    def all_slipping_before(self, number: int) -> bool:
        """Return True if all wheels slip in the window before."""
        return all(self.slipping_wheels(number - 1))

    def slipping_wheels(self, number: int) -> tuple[bool, ...]:
        """Return for each wheel whether it slips in a window."""
        return self.slipping.get(number, (False,) * self.n_wheels)
