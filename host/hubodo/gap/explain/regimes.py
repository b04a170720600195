"""Regimes: the quantity with which a residual varies, such as spin, turns, temperature or time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.process_noise.wheel_phase import estimate_phases, interpolate_phases, window_boundaries
from hubodo.model.forward import NodeInitialState

# s; windows of sums in which steps and intervals are searched
_REGIME_WINDOW = 1.0
# Share of the power by which a regressor has to exceed simpler ones, and by which a second one has to add.
_MIN_SHARE_GAIN, _MIN_SECOND_SHARE = 0.02, 0.12
_SETTLING_TIMES = (4.0, 8.0, 15.0, 30.0, 60.0, 120.0)
# Smallest ratio of a tone to the mean of the spectrum; smallest frequency, Hz, as slower tones may be the
# drive.
_MIN_TONE_RATIO, _MIN_REGIME_TONE_HZ = 30.0, 0.3
_MIN_NAMED_SHARE = 0.3
# Power that the best regressor explains in pure noise, in units of the noise variance.
_MAX_CHANCE_POWER = 30.0
_SETTLING_WORDS = "as it settles after the start"


@dataclass(frozen=True)
class Trajectory:
    """Motion of one node, (N,) each.

    angle, spin, spin_slope: rad, rad/s and rad/s² of its wheel; angle is None on the body
    speed, acceleration, yaw_rate, yaw_acceleration: m/s, m/s², rad/s and rad/s² of the vehicle
    temperature: °C
    """

    t: Array
    angle: Array | None
    spin: Array
    spin_slope: Array
    speed: Array
    acceleration: Array
    yaw_rate: Array
    yaw_acceleration: Array
    temperature: Array


@dataclass(frozen=True)
class Regime:
    """The regime of a series as text, and the share of the series' power that it explains, 0 to 1."""

    description: str
    share: float


def compute_trajectory(node: NodeData) -> Trajectory:
    """Return the trajectory of a node from the inputs, with the wheel angle from the direction of gravity."""
    reading = node.forward.mean_reading((), NodeInitialState())
    body, rolling = reading.body, reading.rolling
    angle = None
    if rolling is not None:
        phases = estimate_phases(node, reading, None, node.accel_scatter)
        angle = rolling.angle + interpolate_phases(node, phases, phases.phase)
    zero = np.zeros_like(body.speed)
    return Trajectory(
        node.t,
        angle,
        zero if rolling is None else rolling.spin,
        zero if rolling is None else rolling.spin_acceleration,
        body.speed,
        body.acceleration,
        body.yaw_rate,
        body.yaw_acceleration,
        body.temperature,
    )


class Regimes:
    """Regressors of one node, which are computed once for all its channels."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self.entries: list[tuple[str, slice]] = []
        self.settling: list[tuple[str, slice]] = []
        columns: list[NDArray[np.float32]] = []
        for words, regressors in chain(_list_regressors(trajectory), _list_settling_regressors(trajectory)):
            sizes = [float(np.sqrt(np.mean(regressor**2))) for regressor in regressors]
            if min(sizes) < 1e-9:
                continue
            entries = self.settling if words.startswith(_SETTLING_WORDS) else self.entries
            entries.append((words, slice(len(columns), len(columns) + len(regressors))))
            columns += [
                (regressor / size).astype(np.float32)
                for regressor, size in zip(regressors, sizes, strict=True)
            ]
        self.columns = np.empty((len(columns), len(trajectory.t)), np.float32)
        for k in reversed(range(len(columns))):
            # Regressors of a long log are large: each is released once copied.
            self.columns[k] = columns.pop()
        self.gram = (self.columns @ self.columns.T).astype(np.float64)

    def find_regime(self, series: Array, noise: Array | float = 0.0) -> Regime:
        """Return the regime of a series, (N,).

        noise: 1 sigma of white noise in it, 0 for a noise-free change
        """
        series = np.asarray(series, np.float64)
        spread = float(np.mean(np.broadcast_to(np.square(noise), series.shape)))
        total = float(series @ series)
        # The power of the noise counts as explained.
        power = max(total - spread * len(series), 1e-3 * total)
        if power <= 0.0:
            return Regime("not at all", 0.0)
        cross = (self.columns @ series.astype(np.float32)).astype(np.float64)
        best_share, description, best_columns = 0.0, "at no particular time", slice(0, 0)
        for name, columns in self.entries:
            share = self._explained_share(cross, np.arange(columns.start, columns.stop), spread, power)
            if share > best_share + _MIN_SHARE_GAIN:
                best_share, description, best_columns = share, name, columns
        name, share = self._find_settling(cross, spread, power)
        # Slow settling resembles a straight line in time: a small difference suffices.
        if share > best_share + 0.2 * _MIN_SHARE_GAIN:
            best_share, description, best_columns = share, name, slice(0, 0)
        for name, share in self._find_events(series, spread, power):
            if share > best_share + 2.0 * _MIN_SHARE_GAIN:
                best_share, description, best_columns = share, name, slice(0, 0)
        if best_columns.stop and best_share < 0.85:
            description, best_share = self._add_second_regressor(
                cross, best_columns, spread, power, description, best_share
            )
        if best_share * power < _MAX_CHANCE_POWER * spread:
            return Regime("at no particular time", 0.0)
        if best_share < _MIN_NAMED_SHARE:
            description = f"{description}, among others" if best_share > 0.1 else "at no particular time"
        return Regime(description, min(best_share, 1.0))

    def _explained_share(self, cross: Array, members: Array, spread: float, power: float) -> float:
        """Return the share of the power that some columns explain, corrected for noise."""
        inner = self.gram[np.ix_(members, members)]
        b = cross[members]
        explained = float(b @ np.linalg.solve(inner + 1e-9 * np.trace(inner) * np.eye(len(b)), b))
        return (explained - spread * len(b)) / power

    def _find_settling(self, cross: Array, spread: float, power: float) -> tuple[str, float]:
        """Return the best settling time, in words, and its share."""
        shares = [
            (self._explained_share(cross, np.arange(place.start, place.stop), spread, power), name)
            for name, place in self.settling
        ]
        share, name = max(shares, default=(0.0, ""))
        return name, share

    def _add_second_regressor(
        self,
        cross: Array,
        best_columns: slice,
        spread: float,
        power: float,
        description: str,
        best_share: float,
    ) -> tuple[str, float]:
        """Return the description and share with a second regressor, if one clearly adds."""
        first = np.arange(best_columns.start, best_columns.stop)
        longer, larger_share = description, best_share
        for name, columns in self.entries:
            if columns == best_columns:
                continue
            members = np.concatenate([first, np.arange(columns.start, columns.stop)])
            share = self._explained_share(cross, members, spread, power)
            if share > larger_share + _MIN_SHARE_GAIN and share > best_share + _MIN_SECOND_SHARE:
                longer, larger_share = f"{description}, and {name}", share
        return longer, larger_share

    def _find_events(self, series: Array, spread: float, power: float) -> Iterator[tuple[str, float]]:
        """Yield descriptions and shares of a step, a level change and a tone."""
        t = self.trajectory.t
        edges = window_boundaries(t, _REGIME_WINDOW)
        sums = np.add.reduceat(series, edges[:-1])
        sum_before, count = np.cumsum(sums), edges[1:].astype(float)
        sum_after, count_after = sum_before[-1] - sum_before, count[-1] - count
        steps = sum_after[:-1] ** 2 / np.maximum(count_after[:-1], 1.0)
        # Each side has its own level; only the step matters.
        two_levels = steps + sum_before[:-1] ** 2 / count[:-1]
        if len(steps):
            largest = int(np.argmax(two_levels))
            if two_levels[largest] < 1.05 * steps[largest]:
                yield f"from {t[edges[largest + 1]]:.0f} s on", (steps[largest] - 2.0 * spread) / power
            else:
                level = two_levels[largest] - 3.0 * spread
                yield f"at another level from {t[edges[largest + 1]]:.0f} s on", level / power
        step = float(np.median(np.diff(t)))
        resampled = np.interp(np.arange(t[0], t[-1], step), t, series - series.mean())
        if len(resampled) > 64:
            spectrum = np.abs(np.fft.rfft(resampled * np.hanning(len(resampled)))) ** 2
            spectrum[: max(3, int(_MIN_REGIME_TONE_HZ * len(resampled) * step))] = 0.0
            peak = int(np.argmax(spectrum))
            peak_power = spectrum[max(0, peak - 2) : peak + 3].sum()
            if spectrum[peak] > _MIN_TONE_RATIO * spectrum.mean():
                share = (
                    peak_power
                    / max(spectrum.sum(), 1e-300)
                    * float(resampled @ resampled)
                    / max(series @ series, 1e-300)
                )
                share = share * float(series @ series) / power
                yield f"as a tone at {peak / (len(resampled) * step):.3g} Hz", share


def describe_interval(t: Array, series: Array, noise: Array | float = 0.0) -> str:
    """Return the short interval with 90 % of a series' power, in words; "" if there is none."""
    edges = window_boundaries(t, _REGIME_WINDOW)
    spread = np.broadcast_to(np.square(noise), series.shape)
    power = np.maximum(np.add.reduceat(series**2 - spread, edges[:-1]), 0.0)
    total = np.concatenate([[0.0], np.cumsum(power)])
    if total[-1] <= 0.0:
        return ""
    # Shortest run of windows with 90 % of the power.
    ends = np.searchsorted(total, total[:-1] + 0.9 * total[-1])
    complete = np.flatnonzero(ends < len(total))
    first = int(complete[np.argmin(ends[complete] - complete)])
    last = int(ends[first])
    if last - first > 0.4 * len(power):
        return ""
    return f"between {t[edges[first]]:.0f} and {t[min(edges[last], len(t) - 1)]:.0f} s"


def _list_regressors(trajectory: Trajectory) -> Iterator[tuple[str, Sequence[Array]]]:
    """Yield regressors with their descriptions, the simpler ones first."""
    constant, age = np.ones_like(trajectory.t), trajectory.t - trajectory.t[0]
    spin, spin_slope, r = trajectory.spin, trajectory.spin_slope, trajectory.yaw_rate
    yield "all the time", [constant]
    yield "in turns", [r]
    yield "in turns, to either side alike", [r**2]
    yield "in turns at speed", [r * trajectory.speed]
    yield "only while turns begin and end", [trajectory.yaw_acceleration]
    if np.ptp(trajectory.temperature) > 0.2:
        yield "with the temperature", [trajectory.temperature - 25.0]
    yield "more and more with time", [age]
    if trajectory.angle is None:
        yield "in proportion to the speed", [trajectory.speed]
        yield "with the square of the speed", [trajectory.speed**2]
        yield "only while the speed changes", [trajectory.acceleration]
    else:
        yield "in proportion to the spin", [spin]
        yield "with the square of the spin", [spin**2]
        yield "with the cube of the spin", [spin**3]
        yield "only while the spin rate changes", [spin_slope]
        yield "while the spin rate changes, most at speed", [spin_slope * spin]
        yield "while the spin rate changes, more and more with time", [spin_slope * age]
        waves = {
            "once": [np.cos(trajectory.angle), np.sin(trajectory.angle)],
            "twice": [np.cos(2.0 * trajectory.angle), np.sin(2.0 * trajectory.angle)],
            "three times": [np.cos(3.0 * trajectory.angle), np.sin(3.0 * trajectory.angle)],
        }
        modulations = [
            ("", constant),
            (", in turns", r),
            (", in turns at speed", r * spin),
            (", in proportion to the spin", spin),
            (", with the square of the spin", spin**2),
            (", while the spin rate changes", spin_slope),
            (", more and more with time", age),
        ]
        for harmonic, wave in waves.items():
            for description, factor in modulations[
                : 7 if harmonic == "once" else 5 if harmonic == "twice" else 1
            ]:
                yield f"{harmonic} per revolution{description}", [factor * component for component in wave]


def _list_settling_regressors(trajectory: Trajectory) -> Iterator[tuple[str, Sequence[Array]]]:
    age = trajectory.t - trajectory.t[0]
    for constant in _SETTLING_TIMES:
        if constant < 2.0 * age[-1]:
            yield f"{_SETTLING_WORDS}, in some {constant:.0f} s", [1.0 - np.exp(-age / constant)]
