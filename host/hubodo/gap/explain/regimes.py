"""What a change or a residual of a channel goes with: spin, turns, revolutions, temperature, time, a tone."""

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

_REGIME_WINDOW = 1.0
# A regressor of more columns has to explain more than chance gives them, and clearly more than a plainer one.
_MIN_SHARE_GAIN, _MIN_SECOND_SHARE = 0.02, 0.12
_SETTLING_TIMES = (4.0, 8.0, 15.0, 30.0, 60.0, 120.0)
# A tone stands this far above the mean of the spectrum, and is not slow enough to be the drive itself.
_MIN_TONE_RATIO, _MIN_REGIME_TONE_HZ = 30.0, 0.3
_MIN_NAMED_SHARE = 0.3
# What the best of all regressors takes from mere noise stays below this, in units of its variance.
_MAX_CHANCE_POWER = 30.0
_SETTLING_WORDS = "as it settles after the start"


@dataclass(frozen=True)
class Trajectory:
    """How one node moved, (N,) each.

    angle: rad, spin: rad/s and its slope, of its wheel, None on the body. speed: m/s, acceleration: m/s²,
    yaw_rate: rad/s and yaw_acceleration: rad/s², of the body. temperature: °C.
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
    """words: what a series goes with. share: of its power that is explained so, 0 to 1."""

    words: str
    share: float


def compute_trajectory(node: NodeData) -> Trajectory:
    """The course of a node: from the inputs, the angle of its wheel from where gravity points."""
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
    """The regressors of one node, made once for all its channels."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self.entries: list[tuple[str, slice]] = []
        self.settling: list[tuple[str, slice]] = []
        columns: list[NDArray[np.float32]] = []
        for words, parts in chain(_list_regressors(trajectory), _list_settling_regressors(trajectory)):
            sizes = [float(np.sqrt(np.mean(part**2))) for part in parts]
            if min(sizes) < 1e-9:
                continue
            entries = self.settling if words.startswith(_SETTLING_WORDS) else self.entries
            entries.append((words, slice(len(columns), len(columns) + len(parts))))
            columns += [(part / size).astype(np.float32) for part, size in zip(parts, sizes, strict=True)]
        self.columns = np.empty((len(columns), len(trajectory.t)), np.float32)
        for k in reversed(range(len(columns))):
            # Of a long log they are large: what is copied goes at once.
            self.columns[k] = columns.pop()
        self.gram = (self.columns @ self.columns.T).astype(np.float64)

    def find_regime(self, series: Array, noise: Array | float = 0.0) -> Regime:
        """What a series, (N,), goes with. noise: 1 sigma of white noise in it, 0 for a pure change."""
        series = np.asarray(series, np.float64)
        spread = float(np.mean(np.broadcast_to(np.square(noise), series.shape)))
        total = float(series @ series)
        # What noise alone makes of the power is not there to be explained.
        power = max(total - spread * len(series), 1e-3 * total)
        if power <= 0.0:
            return Regime("not at all", 0.0)
        cross = (self.columns @ series.astype(np.float32)).astype(np.float64)
        best, words, chosen = 0.0, "at no particular time", slice(0, 0)
        for name, place in self.entries:
            share = self._explained_share(cross, np.arange(place.start, place.stop), spread, power)
            if share > best + _MIN_SHARE_GAIN:
                best, words, chosen = share, name, place
        name, share = self._find_settling(cross, spread, power)
        # A straight line in time is close to settling slowly: here a little is clear enough.
        if share > best + 0.2 * _MIN_SHARE_GAIN:
            best, words, chosen = share, name, slice(0, 0)
        for name, share in self._find_events(series, spread, power):
            if share > best + 2.0 * _MIN_SHARE_GAIN:
                best, words, chosen = share, name, slice(0, 0)
        if chosen.stop and best < 0.85:
            words, best = self._add_second_regressor(cross, chosen, spread, power, words, best)
        if best * power < _MAX_CHANCE_POWER * spread:
            return Regime("at no particular time", 0.0)
        if best < _MIN_NAMED_SHARE:
            words = f"{words}, among others" if best > 0.1 else "at no particular time"
        return Regime(words, min(best, 1.0))

    def _explained_share(self, cross: Array, members: Array, spread: float, power: float) -> float:
        inner = self.gram[np.ix_(members, members)]
        b = cross[members]
        explained = float(b @ np.linalg.solve(inner + 1e-9 * np.trace(inner) * np.eye(len(b)), b))
        return (explained - spread * len(b)) / power

    def _find_settling(self, cross: Array, spread: float, power: float) -> tuple[str, float]:
        """The best of the times in which something settles after the start."""
        shares = [
            (self._explained_share(cross, np.arange(place.start, place.stop), spread, power), name)
            for name, place in self.settling
        ]
        share, name = max(shares, default=(0.0, ""))
        return name, share

    def _add_second_regressor(
        self, cross: Array, chosen: slice, spread: float, power: float, words: str, best: float
    ) -> tuple[str, float]:
        first = np.arange(chosen.start, chosen.stop)
        further, more = words, best
        for name, place in self.entries:
            if place == chosen:
                continue
            members = np.concatenate([first, np.arange(place.start, place.stop)])
            share = self._explained_share(cross, members, spread, power)
            if share > more + _MIN_SHARE_GAIN and share > best + _MIN_SECOND_SHARE:
                further, more = f"{words}, and {name}", share
        return further, more

    def _find_events(self, series: Array, spread: float, power: float) -> Iterator[tuple[str, float]]:
        """A step, an interval, a tone."""
        t = self.trajectory.t
        edges = window_boundaries(t, _REGIME_WINDOW)
        sums = np.add.reduceat(series, edges[:-1])
        before, count = np.cumsum(sums), edges[1:].astype(float)
        after, rest = before[-1] - before, count[-1] - count
        steps = after[:-1] ** 2 / np.maximum(rest[:-1], 1.0)
        # Both sides at a level of their own; only the step is news.
        both = steps + before[:-1] ** 2 / count[:-1]
        if len(steps):
            at = int(np.argmax(both))
            if both[at] < 1.05 * steps[at]:
                yield f"from {t[edges[at + 1]]:.0f} s on", (steps[at] - 2.0 * spread) / power
            else:
                level = both[at] - 3.0 * spread
                yield f"at another level from {t[edges[at + 1]]:.0f} s on", level / power
        step = float(np.median(np.diff(t)))
        even = np.interp(np.arange(t[0], t[-1], step), t, series - series.mean())
        if len(even) > 64:
            spectrum = np.abs(np.fft.rfft(even * np.hanning(len(even)))) ** 2
            spectrum[: max(3, int(_MIN_REGIME_TONE_HZ * len(even) * step))] = 0.0
            peak = int(np.argmax(spectrum))
            near = spectrum[max(0, peak - 2) : peak + 3].sum()
            if spectrum[peak] > _MIN_TONE_RATIO * spectrum.mean():
                share = near / max(spectrum.sum(), 1e-300) * float(even @ even) / max(series @ series, 1e-300)
                share = share * float(series @ series) / power
                yield f"as a tone at {peak / (len(even) * step):.3g} Hz", share


def describe_interval(t: Array, series: Array, noise: Array | float = 0.0) -> str:
    """The one stretch in which nearly all the power of a series lies, in words; "" where it is spread out."""
    edges = window_boundaries(t, _REGIME_WINDOW)
    spread = np.broadcast_to(np.square(noise), series.shape)
    power = np.maximum(np.add.reduceat(series**2 - spread, edges[:-1]), 0.0)
    total = np.concatenate([[0.0], np.cumsum(power)])
    if total[-1] <= 0.0:
        return ""
    # The shortest run of windows with nine tenths of it.
    ends = np.searchsorted(total, total[:-1] + 0.9 * total[-1])
    possible = np.flatnonzero(ends < len(total))
    first = int(possible[np.argmin(ends[possible] - possible)])
    last = int(ends[first])
    if last - first > 0.4 * len(power):
        return ""
    return f"between {t[edges[first]]:.0f} and {t[min(edges[last], len(t) - 1)]:.0f} s"


def _list_regressors(trajectory: Trajectory) -> Iterator[tuple[str, Sequence[Array]]]:
    """Regressors with their names, the plainer ones first."""
    one, age = np.ones_like(trajectory.t), trajectory.t - trajectory.t[0]
    spin, slope, r = trajectory.spin, trajectory.spin_slope, trajectory.yaw_rate
    yield "all the time", [one]
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
        yield "only while the spin rate changes", [slope]
        yield "while the spin rate changes, most at speed", [slope * spin]
        yield "while the spin rate changes, more and more with time", [slope * age]
        waves = {
            "once": [np.cos(trajectory.angle), np.sin(trajectory.angle)],
            "twice": [np.cos(2.0 * trajectory.angle), np.sin(2.0 * trajectory.angle)],
            "three times": [np.cos(3.0 * trajectory.angle), np.sin(3.0 * trajectory.angle)],
        }
        with_what = [
            ("", one),
            (", in turns", r),
            (", in turns at speed", r * spin),
            (", in proportion to the spin", spin),
            (", with the square of the spin", spin**2),
            (", while the spin rate changes", slope),
            (", more and more with time", age),
        ]
        for often, wave in waves.items():
            for words, by in with_what[: 7 if often == "once" else 5 if often == "twice" else 1]:
                yield f"{often} per revolution{words}", [by * part for part in wave]


def _list_settling_regressors(trajectory: Trajectory) -> Iterator[tuple[str, Sequence[Array]]]:
    age = trajectory.t - trajectory.t[0]
    for constant in _SETTLING_TIMES:
        if constant < 2.0 * age[-1]:
            yield f"{_SETTLING_WORDS}, in some {constant:.0f} s", [1.0 - np.exp(-age / constant)]
