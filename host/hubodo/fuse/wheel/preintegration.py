"""The samples of one node, and how they are cut into windows."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.glitches import GlitchFilter, SampleRow, find_jumps
from hubodo.fuse.wheel.integrals import CZ, GZ, MISSING, SAMPLE_ROWS, WI, WR, build_windows, integrands
from hubodo.fuse.wheel.window import WINDOW_S, Window, slice_samples
from hubodo.recording import Table
from hubodo.vehicle import Facing, facing_sign


@dataclass(frozen=True, slots=True)
class WheelSample:
    """One sample of a node. t: s on the log's clock; gyro: rad/s, accel: m/s², node axes, finite.

    beyond_range: 1.0 where a second accelerometer replaced saturated values, else 0.0.
    """

    node: str
    t: float
    gyro: tuple[float, float, float]
    accel: tuple[float, float, float]
    beyond_range: float = 0.0


BEYOND_RANGE = "beyond_range"
"""Column of a node's table with `WheelSample.beyond_range`; missing if it is always 0."""

SampleBlock = tuple[Array, Array, Array] | tuple[Array, Array, Array, Array]
"""Samples of a node: t (N,) s, gyro (N, 3) rad/s, accel (N, 3) m/s², and optionally `BEYOND_RANGE` (N,)."""


def sample_block(table: Table) -> SampleBlock:
    """Return the samples of a node's table for `WheelFilter.handle_blocks`."""
    samples = table.t, table.gyro, table.accel
    return (*samples, table[BEYOND_RANGE]) if BEYOND_RANGE in table else samples


MAX_BRIDGED_GAP = 0.8
"""s between samples up to which a gap is interpolated linearly; a longer gap is a pause.

Shorter than the time for which the filter waits for a late node, so that log and live run see the same
pauses. At walking pace the curvature of the wheel's rate is not visible in gravity meanwhile. Estimated.
"""

MAX_SAMPLE_STEP = 0.08
"""s between samples; longer is a gap. The slowest rate of an LSM6DS33 is 13 Hz, 0.077 s."""

_SAMPLES_PER_BLOCK = 4096
"""Samples per block, so that its intermediate arrays fit into the processor's cache."""


@dataclass
class WindowBuilder:
    """A cutter of one node's samples into windows that do not depend on how samples are split into blocks.

    Integrals run over the linear interpolation from the first sample after a pause; a window is the
    difference of two of them. Sums are made sequentially, as in a live run. No windows cover a pause (a gap
    longer than MAX_BRIDGED_GAP). The first sample after a pause counts once a second one follows, because a
    single wrong time stamp is no pause. Samples after a jump of the rate count once it has stayed.

    Attributes
    ----------
    facing : direction of the node's z axis.
    start : s, time of the first edge.
    gyro_limit, accel_limit : rad/s and m/s², beyond which a sample counts as clipped.
    n_rejected : number of samples left out.
    """

    facing: Facing
    start: float
    gyro_limit: float = np.inf
    accel_limit: float = np.inf
    n_rejected: int = 0
    _edge: int = -(1 << 62)  # the first sample sets it; times may be negative
    _time: list[float] = field(default_factory=list)
    _rows: list[SampleRow] = field(default_factory=list)
    _newest: float | None = None
    _accepted: float | None = None
    _glitches: GlitchFilter = field(default_factory=GlitchFilter)
    _pending_sample: tuple[float, SampleRow] | None = None
    _last_integrals: tuple[Array, Array, Array] | None = None
    _edge_values: Array | None = None
    _sample_rows: tuple[Array, Array] | None = None

    @property
    def newest_t(self) -> float | None:
        """Return the time of the newest accepted sample, s."""
        return self._accepted

    @property
    def n_glitches(self) -> int:
        """Return the number of rejected samples whose rate jumped and returned."""
        return self._glitches.n_rejected

    def add(
        self, t: float, gyro: tuple[float, ...], accel: tuple[float, ...], beyond_range: float = 0.0
    ) -> list[Window]:
        """Add one sample and return the windows it completes.

        A sample whose time does not increase, or that jumps ahead without a successor, or whose rate jumps
        and returns, is counted and left out. beyond_range: 1.0 where a second accelerometer replaced
        saturated values.
        """
        row = (*gyro, *accel, beyond_range)
        if self._newest is None:
            return self._start(t, row)
        if 0.0 < t - self._newest <= MAX_BRIDGED_GAP:
            # The pending sample that jumped ahead has no successor.
            self.n_rejected += self._pending_sample is not None
            self._pending_sample = None
            return self._continue(t, row)
        if t <= self._newest:
            self.n_rejected += 1
            return []
        if self._pending_sample is not None and 0.0 < t - self._pending_sample[0] <= MAX_BRIDGED_GAP:
            pending, self._pending_sample = self._pending_sample, None
            self._restart()
            return [*self._start(*pending), *self._continue(t, row)]
        self.n_rejected += self._pending_sample is not None
        self._pending_sample = t, row
        return []

    def _start(self, t: float, row: SampleRow) -> list[Window]:
        """Add the first sample, or the first one after a pause."""
        self._newest = t
        n_before = self._glitches.n_rejected
        self._glitches.restart(row)
        self.n_rejected += self._glitches.n_rejected - n_before
        return self._append_sample(t, row)

    def _continue(self, t: float, row: SampleRow) -> list[Window]:
        """Add a sample without a pause before it, and those after a jump of the rate that it confirms."""
        assert self._newest is not None and self._accepted is not None
        n_before = self._glitches.n_rejected
        accepted = self._glitches.add(t - self._newest, t, row)
        self.n_rejected += self._glitches.n_rejected - n_before
        self._newest = t
        if accepted and accepted[0][0] - self._accepted > MAX_BRIDGED_GAP:
            self._restart()
        return [window for sample in accepted for window in self._append_sample(*sample)]

    def add_many(
        self, t: Array, gyro: Array, accel: Array, beyond_range: Array | None = None
    ) -> list[Window]:
        """Add many samples and return the windows they complete.

        t: (N,) s, gyro: (N, 3) rad/s, accel: (N, 3) m/s², all finite; beyond_range: (N,) as in `add`.
        """
        windows: list[Window] = []
        beyond_range = np.zeros(len(t)) if beyond_range is None else beyond_range
        position, count = 0, len(t)
        while position < count:
            n_unbroken = self._count_unbroken(t[position:], gyro[position:])
            if n_unbroken:
                block = slice(position, position + n_unbroken)
                windows += self._append_samples(t[block], gyro[block], accel[block], beyond_range[block])
                position += n_unbroken
            # Samples after a gap or a jump are processed one by one.
            while position < count and not self._is_smooth(float(t[position]), gyro[position].tolist()):
                windows += self.add(
                    float(t[position]),
                    tuple(gyro[position].tolist()),
                    tuple(accel[position].tolist()),
                    float(beyond_range[position]),
                )
                position += 1
        return windows

    def _is_smooth(self, t: float, gyro: list[float]) -> bool:
        """Return True if a sample at `t` continues the record without a jump, and no other is pending."""
        if self._newest is None:
            return True
        step = t - self._newest
        is_continuous = 0.0 < step <= MAX_BRIDGED_GAP and self._pending_sample is None
        return is_continuous and self._glitches.is_smooth(step, gyro)

    def _count_unbroken(self, t: Array, gyro: Array) -> int:
        """Return the number of leading samples without a gap or a jump."""
        if not self._is_smooth(float(t[0]), gyro[0].tolist()):
            return 0
        steps = np.diff(t)
        broken = np.flatnonzero(~((steps > 0.0) & (steps <= MAX_BRIDGED_GAP)) | find_jumps(t, gyro))
        return int(broken[0]) + 1 if len(broken) else len(t)

    def _restart(self) -> None:
        """Restart the integrals; samples that do not fill a window are dropped."""
        self._time, self._rows = [], []
        self._last_integrals = self._edge_values = None

    def _append_sample(self, t: float, row: SampleRow) -> list[Window]:
        self._accepted = t
        self._time.append(t)
        self._rows.append(row)
        is_incomplete = self._last_integrals is not None and t < self.start + self._edge * WINDOW_S
        if is_incomplete or (self._last_integrals is None and len(self._time) < 2):
            return []
        rows = np.array(self._rows)
        time = np.array(self._time)
        self._time, self._rows = [], []
        return self._integrate(time, rows[:, :3], rows[:, 3:6], rows[:, 6])

    def _append_samples(self, t: Array, gyro: Array, accel: Array, beyond_range: Array) -> list[Window]:
        self._newest = self._accepted = float(t[-1])
        self._glitches.restart(tuple(gyro[-1].tolist()))
        if self._time:
            pending_rows = np.array(self._rows)
            t = np.concatenate([self._time, t])
            gyro, accel, beyond_range = (
                np.concatenate([pending_rows[:, :3], gyro]),
                np.concatenate([pending_rows[:, 3:6], accel]),
                np.concatenate([pending_rows[:, 6], beyond_range]),
            )
            self._time, self._rows = [], []
        if len(t) + (self._last_integrals is not None) < 2:
            self._time = t.tolist()
            self._rows = [(*g, *a, b) for g, a, b in zip(gyro, accel, beyond_range, strict=True)]
            return []
        windows = []
        for first in range(0, len(t), _SAMPLES_PER_BLOCK):
            block = slice(first, first + _SAMPLES_PER_BLOCK)
            windows += self._integrate(t[block], gyro[block], accel[block], beyond_range[block])
        return windows

    def _integrate(self, t: Array, gyro: Array, accel: Array, beyond_range: Array) -> list[Window]:
        sign, limits = facing_sign(self.facing), (self.gyro_limit, self.accel_limit)
        if self._last_integrals is None:
            self._edge = max(self._edge, int(np.ceil((t[0] - self.start) / WINDOW_S - 1e-9)))
            rows = integrands(gyro[:1], accel[:1], np.zeros(1), sign, limits, beyond_range[:1])
            self._last_integrals = (t[:1], rows, np.zeros((CZ + 2, 1)))
            self._sample_rows = (t[:1], np.concatenate([rows[SAMPLE_ROWS, :], beyond_range[None, :1]]))
            t, gyro, accel, beyond_range = t[1:], gyro[1:], accel[1:], beyond_range[1:]
        t_before, rows_before, totals_before = self._last_integrals
        t = np.concatenate([t_before, t])
        step = t[1:] - t[:-1]
        spin = np.concatenate([rows_before[GZ], sign * gyro[:, 2]])
        totals = np.empty((CZ + 2, len(t)))
        totals[:, :1] = totals_before
        totals[GZ, 1:] = 0.5 * (spin[:-1] + spin[1:]) * step
        angle = np.cumsum(totals[GZ])
        rows = np.concatenate(
            [rows_before, integrands(gyro, accel, angle[1:], sign, limits, beyond_range)], axis=1
        )
        totals[:-1, 1:] = 0.5 * (rows[:, :-1] + rows[:, 1:]) * step
        totals[-1, 1:] = np.where(step > MAX_SAMPLE_STEP, step, 0.0)
        np.cumsum(totals, axis=1, out=totals)
        windows = self._with_samples(self._close_windows(t, rows, totals), t, rows, beyond_range)
        self._last_integrals = (t[-1:].copy(), rows[:, -1:].copy(), totals[:, -1:].copy())
        return windows

    def _with_samples(
        self, windows: list[Window], t: Array, rows: Array, beyond_range: Array
    ) -> list[Window]:
        """Attach samples to windows with a clipped spin, and the share of samples beyond the range.

        t, rows: from the last sample of the previous block on; beyond_range: after it.
        """
        assert self._sample_rows is not None
        time = np.concatenate([self._sample_rows[0], t[1:]])
        new_rows = np.concatenate([rows[SAMPLE_ROWS, 1:], beyond_range[None]])
        sample_rows = np.concatenate([self._sample_rows[1], new_rows], axis=1)
        is_extended = bool(sample_rows[-1].any())
        for index, window in enumerate(windows):
            window_start = self.start + window.number * WINDOW_S
            if is_extended:
                first, end = np.searchsorted(time, [window_start, window_start + WINDOW_S])
                share = float(np.mean(sample_rows[-1, first:end])) if end > first else 0.0
                windows[index] = window = window._replace(beyond_range=share)
            if window.spin_clipped > 0.0:
                windows[index] = window._replace(
                    samples=slice_samples(
                        time, sample_rows, window_start, window_start + WINDOW_S, self.accel_limit
                    )
                )
        edge = self.start + (self._edge - 1) * WINDOW_S
        first = max(0, int(np.searchsorted(time, edge, side="right")) - 1) if windows else 0
        self._sample_rows = (time[first:].copy(), sample_rows[:, first:].copy())
        return windows

    def _close_windows(self, t: Array, rows: Array, totals: Array) -> list[Window]:
        last = int(np.floor((t[-1] - self.start) / WINDOW_S + 1e-9))
        numbers = np.arange(self._edge, max(last, self._edge - 1) + 1)
        edges = self.start + numbers * WINDOW_S
        is_covered = (edges <= t[-1]) & (edges >= t[0])
        numbers, edges = numbers[is_covered], edges[is_covered]
        if not len(numbers):
            return []
        right = np.maximum(np.searchsorted(t, edges, side="left"), 1)
        left = right - 1
        step = t[right] - t[left]
        fraction = (edges - t[left]) / step
        y0, y1 = rows[:, left], rows[:, right]
        edge_values = np.empty((CZ + 5, len(edges)))
        edge_values[: CZ + 1] = totals[:-1, left] + step * fraction * (y0 + 0.5 * fraction * (y1 - y0))
        edge_values[MISSING] = totals[-1, left] + fraction * (totals[-1, right] - totals[-1, left])
        # Interpolate the values at the edge.
        rows_at_edge = [GZ, WR, WI]
        edge_values[MISSING + 1 :] = y0[rows_at_edge] + fraction * (y1[rows_at_edge] - y0[rows_at_edge])
        first = self._edge - (self._edge_values is not None)
        self._edge = int(numbers[-1]) + 1
        if self._edge_values is not None:
            edge_values = np.concatenate([self._edge_values, edge_values], axis=1)
        self._edge_values = edge_values[:, -1:].copy()
        return build_windows(first, edge_values)
