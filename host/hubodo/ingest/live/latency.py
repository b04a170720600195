"""How long something takes, as a histogram that does not grow: median, 99th percentile, worst."""

from __future__ import annotations

from hubodo.units import NS_PER_S

_BIN_NS = 20_000
_BINS = 5000


class Latency:
    """Durations in bins of 20 us up to 0.1 s; the worst one is kept exactly."""

    def __init__(self) -> None:
        self.count = 0
        self._total_ns = 0
        self._worst_ns = 0
        self._bins = [0] * (_BINS + 1)

    def add(self, ns: int) -> None:
        """One duration, ns."""
        self.count += 1
        self._total_ns += ns
        self._worst_ns = max(self._worst_ns, ns)
        self._bins[min(max(ns, 0) // _BIN_NS, _BINS)] += 1

    @property
    def mean(self) -> float | None:
        """s; None before the first one."""
        return self._total_ns / self.count / NS_PER_S if self.count else None

    @property
    def worst(self) -> float | None:
        """s; None before the first one."""
        return self._worst_ns / NS_PER_S if self.count else None

    def quantile(self, share: float) -> float | None:
        """s below which that share of the durations lies, to 20 us and never below the truth.

        None before the first one.
        """
        seen = 0
        for place, number in enumerate(self._bins):
            seen += number
            if self.count and seen >= share * self.count:
                # The last bin has no upper end but the worst.
                return min((place + 1) * _BIN_NS, self._worst_ns) / NS_PER_S if place < _BINS else self.worst
        return None

    def as_json(self) -> dict[str, float | None]:
        """Median, p99, worst and mean, s."""
        return {
            "latency_median": self.quantile(0.5),
            "latency_p99": self.quantile(0.99),
            "latency_worst": self.worst,
            "latency_mean": self.mean,
        }
