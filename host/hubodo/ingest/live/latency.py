"""A latency histogram of constant size with median, 99th percentile and maximum."""

from __future__ import annotations

from hubodo.units import NS_PER_S

_BIN_WIDTH_NS = 20_000
_BIN_COUNT = 5000


class LatencyHistogram:
    """A histogram of durations in bins of 20 us up to 0.1 s, with the exact maximum."""

    def __init__(self) -> None:
        self.count = 0
        self._total_ns = 0
        self._maximum_ns = 0
        self._bins = [0] * (_BIN_COUNT + 1)

    def add(self, ns: int) -> None:
        """Add a duration, ns."""
        self.count += 1
        self._total_ns += ns
        self._maximum_ns = max(self._maximum_ns, ns)
        self._bins[min(max(ns, 0) // _BIN_WIDTH_NS, _BIN_COUNT)] += 1

    @property
    def mean(self) -> float | None:
        """Mean duration, s; None if empty."""
        return self._total_ns / self.count / NS_PER_S if self.count else None

    @property
    def maximum(self) -> float | None:
        """Longest duration, s; None if empty."""
        return self._maximum_ns / NS_PER_S if self.count else None

    def quantile(self, share: float) -> float | None:
        """Return the duration, s, below which the given share lies, rounded up to 20 us; None if empty."""
        cumulative = 0
        for index, number in enumerate(self._bins):
            cumulative += number
            if self.count and cumulative >= share * self.count:
                # The last bin is bounded by the maximum only.
                return (
                    min((index + 1) * _BIN_WIDTH_NS, self._maximum_ns) / NS_PER_S
                    if index < _BIN_COUNT
                    else self.maximum
                )
        return None

    def as_json(self) -> dict[str, float | None]:
        """Return median, 99th percentile, maximum and mean, s."""
        return {
            "latency_median": self.quantile(0.5),
            "latency_p99": self.quantile(0.99),
            "latency_worst": self.maximum,
            "latency_mean": self.mean,
        }
