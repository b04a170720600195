"""A throttle for recurring events: the first is reported at once, later ones at growing intervals."""

from __future__ import annotations

_MIN_INTERVAL_NS = 10_000_000_000
_MAX_INTERVAL_NS = 3_600_000_000_000


class EventThrottle:
    """A throttle that admits the first event at once, later ones at intervals doubling from 10 s to 1 h.

    An interval without any event resets it.
    """

    def __init__(self) -> None:
        self._withheld = 0
        self._interval_ns = 0
        self._next_ns = 0

    def admit(self, t_ns: int) -> int | None:
        """Return the number of events withheld since the last admitted one; None to withhold this one too."""
        if t_ns < self._next_ns:
            self._withheld += 1
            return None
        was_quiet = t_ns >= self._next_ns + self._interval_ns
        self._interval_ns = _MIN_INTERVAL_NS if was_quiet else min(2 * self._interval_ns, _MAX_INTERVAL_NS)
        self._next_ns = t_ns + self._interval_ns
        withheld, self._withheld = self._withheld, 0
        return withheld

    def reset(self) -> None:
        """Admit the next event."""
        self._interval_ns = self._next_ns = 0
