"""Slips of all wheels: late detection, then rollback to slip onset and replay of the windows since."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from hubodo.fuse.wheel.entries import HEADING, SPEED, X, Y
from hubodo.fuse.wheel.measurement_update import UpdateResult
from hubodo.fuse.wheel.measurements import rolling
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.slip_detector import SUM_LENGTHS_WINDOWS, ForwardResidual
from hubodo.fuse.wheel.thresholds import GATE_SIGMA, MAX_UNCONFIRMED_WINDOWS
from hubodo.fuse.wheel.wheel import Wheel
from hubodo.fuse.wheel.window import WINDOW_S, Window
from hubodo.fuse.wheel.window_processor import WindowProcessor

HISTORY_WINDOWS = MAX_UNCONFIRMED_WINDOWS + SUM_LENGTHS_WINDOWS[-1]
"""Windows to keep: the longest slip, and the longest time before its detection."""


class _SlipSpeed(NamedTuple):
    """Slip speed, m/s by which a wheel is faster than the vehicle, and its variance, (m/s)²."""

    slip: float
    variance: float


class _OpenSlip(NamedTuple):
    """A slip in progress: earliest window of its onset, and slip speed when the wheel became consistent."""

    earliest: int
    consistent: _SlipSpeed = _SlipSpeed(0.0, 0.0)


class SlipMonitor:
    """A monitor that detects slips after each window and replays the windows since their onset."""

    def __init__(self) -> None:
        self._headings: deque[float] = deque(maxlen=HISTORY_WINDOWS)
        self._open_slips = [_OpenSlip(0), _OpenSlip(0)]
        self._moving_since = 0

    def process(self, core: WindowProcessor, result: UpdateResult) -> UpdateResult:
        """Detect slips that begin or end with the newest window; return the result after a replay."""
        if not core.history.is_replayable:
            return result
        self._headings.append(core.x[core.columns.vehicle[HEADING]])
        newest = core.history.newest
        if result.motion_state is not MotionState.MOVING:
            self._moving_since = newest.number + 1
        starts = [
            self._detect_end(core, index, wheel, window, result.forward_residuals[index])
            if wheel.slip_detector.is_slipping
            else self._detect_onset(core, index, wheel, window, result)
            for index, (wheel, window) in enumerate(newest.windows)
        ]
        replay_from = [start for start in starts if start is not None]
        if not replay_from:
            return result
        result = core.replay(min(replay_from))
        for wheel in core.wheels:
            wheel.slip_detector.clear_sums()
        return result

    def _detect_onset(
        self, core: WindowProcessor, index: int, wheel: Wheel, window: Window, result: UpdateResult
    ) -> int | None:
        """Return the window in which a slip of a rolling wheel began, if one is detected."""
        if result.motion_state is not MotionState.MOVING:
            wheel.slip_detector.record_standstill()
            return None
        if window.spin_clipped > 0.0:
            # The wheel angle has just been determined from gravity alone.
            wheel.slip_detector.require_agreement()
            return None
        now, first_replayable = core.history.newest.number, core.history.first_replayable
        first = wheel.slip_detector.detect_onset(
            now, result.forward_residuals[index], result.rolling_rates[index]
        )
        if first is None:
            return None
        first = max(first, first_replayable)
        earliest = max(first_replayable, self._moving_since, first - SUM_LENGTHS_WINDOWS[-1])
        self._open_slips[index] = _OpenSlip(min(first, earliest))
        wheel.slip_detector.start_slip(first)
        core.slip_schedule.mark(index, range(first, now + 1))
        return first

    def _detect_end(
        self,
        core: WindowProcessor,
        index: int,
        wheel: Wheel,
        window: Window,
        forward: ForwardResidual | None,
    ) -> int | None:
        """Return the window from which on the speed is in doubt, if a slip ends and the speed was wrong.

        A wheel that rolls again at another speed than the inertial one shows that the latter was wrong during
        the slip. If the error is significant, it began before the slip was detected: a wheel in the air slows
        down gradually, and its loss of speed shows when it touches the road again. A wheel that rolls again
        without having jumped back has been rolling since it became consistent with its accelerometer.
        """
        detector, now = wheel.slip_detector, core.history.newest.number
        slip, variance = self._slip_speed(core, wheel, window)
        inertial_speed = core.x[core.columns.vehicle[SPEED]] if core.inertial_speed else None
        has_ended = detector.detect_end(now, forward, slip, variance, inertial_speed, core.max_speed)
        if detector.consistent_windows <= 1:
            self._open_slips[index] = self._open_slips[index]._replace(consistent=_SlipSpeed(slip, variance))
        if not has_ended:
            return None
        ended, open_slip = detector.slips[-1], self._open_slips[index]
        if inertial_speed is not None and detector.consistent_windows:
            ended.last = max(ended.first, now - detector.consistent_windows)
            slip, variance = open_slip.consistent
            if not detector.ended_by_jump:
                # The wheel is taken as rolling even if the inertial speed was more certain.
                variance = 0.0
        assert ended.last is not None
        end = ended.last + 1
        core.slip_schedule.mark(index, range(end, now + 1), slipping=False)
        square = slip * slip - variance
        if square <= 0.0:
            return None
        is_significant = slip * slip > GATE_SIGMA**2 * variance
        first = open_slip.earliest if is_significant else ended.first
        core.slip_schedule.mark(index, range(first, end))
        core.slip_schedule.inflate_speed(range(first, end), square)
        if first >= core.history.first_replayable:
            return first
        self._inflate_position(core, square, now + 1 - first)
        return None

    def _slip_speed(self, core: WindowProcessor, wheel: Wheel, window: Window) -> _SlipSpeed:
        """Return the slip speed of a wheel under the present states."""
        wheel.view.linearise(core.x, window, is_stationary=False)
        row = rolling.measure(wheel.view, core.noise)
        h = core.derivatives(row, wheel.columns)
        return _SlipSpeed(row[0] / WINDOW_S, (float(h @ core.p @ h) + row[1]) / WINDOW_S**2)

    def _inflate_position(self, core: WindowProcessor, square: float, windows: int) -> None:
        """Inflate position and speed for a speed error during windows that cannot be replayed.

        A speed error of at most s during a time T, with heading u(t), moves the position by e with
        e e' <= s² T ∫ u u' dt (Cauchy-Schwarz). square: s², (m/s)².
        """
        columns = core.columns.vehicle
        position = np.ix_([columns[X], columns[Y]], [columns[X], columns[Y]])
        headings = list(self._headings)[-windows:]
        directions = np.array([np.cos(headings), np.sin(headings)])
        core.p[position] += square * WINDOW_S**2 * windows * (directions @ directions.T)
        core.p[columns[SPEED], columns[SPEED]] += square
