"""Which wheels spin by themselves, window by window, and how far the speed is doubted meanwhile."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class SlipSchedule:
    """What one look at the windows finds and the next is told: a step back in time, or a smoother.

    wheels: how many there are. lost: by number of the window, of each whether it is; a window without any is
    not in it. doubt:
    (m/s)² by which the variance of the speed grows in a window beside what it does anyway, by its number.
    """

    wheels: int
    slipping: dict[int, tuple[bool, ...]] = field(default_factory=dict)
    speed_variance: dict[int, float] = field(default_factory=dict)

    def mark(self, wheel: int, numbers: range, slipping: bool = True) -> None:
        """That one wheel was lost in these windows, or was not."""
        for number in numbers:
            away = list(self.slipping_wheels(number))
            away[wheel] = slipping
            if any(away):
                self.slipping[number] = tuple(away)
            else:
                self.slipping.pop(number, None)

    def inflate_speed(self, numbers: range, wrong: float) -> None:
        """That the speed was wrong in the end, (m/s)², after it had been carried through these windows.

        It has become so at a time that nobody knows: in equal parts in all of them, a random walk. Between
        both ends that is a Brownian bridge, whose variance is that of a jump at a time that is uniformly
        distributed.
        """
        for number in numbers:
            self.speed_variance[number] = self.speed_variance.get(number, 0.0) + wrong / len(numbers)

    def count_windows(self, wheel: int) -> int:
        """In how many it was lost."""
        return sum(away[wheel] for away in self.slipping.values())

    def all_slipping_before(self, number: int) -> bool:
        """Whether nothing but accelerometers told the speed in the window before."""
        return all(self.slipping_wheels(number - 1))

    def slipping_wheels(self, number: int) -> tuple[bool, ...]:
        """Of each wheel, whether it is lost in a window."""
        return self.slipping.get(number, (False,) * self.wheels)
