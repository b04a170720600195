"""Core of the wheel filter, an error-state Kalman filter: one step from windows of all wheels to a pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from operator import itemgetter

import numpy as np

from hubodo.fuse.wheel.axle_rate import remove_tilt_rate
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import RATE_BEYOND_RANGE, SPEED, WHEEL_ANGLE, X, Y
from hubodo.fuse.wheel.measurement_update import UpdateResult
from hubodo.fuse.wheel.measurements import surface_speed
from hubodo.fuse.wheel.motion_model import HeadingErrorInflation
from hubodo.fuse.wheel.motion_prediction import detect_wheel_motion
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.mounting_check import MountingCheck
from hubodo.fuse.wheel.mounting_monitor import check_mounting
from hubodo.fuse.wheel.outage_bridge import OutageEnd
from hubodo.fuse.wheel.outage_processor import OutageProcessor
from hubodo.fuse.wheel.rate_beyond_range import derotate_window
from hubodo.fuse.wheel.records import (
    POSE_ENTRIES,
    History,
    Pose,
    SlipSchedule,
    SmoothingTerms,
    StepInput,
    StepRecord,
    WheelWindows,
    common_scale_covariance,
)
from hubodo.fuse.wheel.slip_monitor import HISTORY_WINDOWS, SlipMonitor
from hubodo.fuse.wheel.state_vector import ExternalCorrection, StateReset, initial_state
from hubodo.fuse.wheel.thresholds import GATE_SIGMA
from hubodo.fuse.wheel.window import EMPTY_WINDOW, WINDOW_S, WINDOWS_PER_SECOND, Window

_MIN_ROLLING_START_SPEED = GATE_SIGMA * SPEED.prior
"""m/s; a first window that is faster is not a start from standstill."""

_NO_COVARIANCE = np.empty((0, 0))
"""Covariance of the poses of a pass whose smoothing computes it."""


class FilterCore(OutageProcessor):
    """State of the wheel filter and its steps.

    Attributes
    ----------
    steps : number of windows with samples so far.
    mounting_check : accumulated evidence on the mounting.
    pose_columns : columns of the states of a pose.
    newest_terms : terms of the last step for smoothing, if the changes are recorded.
    """

    def __init__(
        self,
        config: WheelConfig,
        slips: SlipSchedule | None = None,
        outage_ends: Mapping[int, OutageEnd] | None = None,
        *,
        smoothing: bool = False,
    ) -> None:
        """Start at standstill.

        slips, outage_ends: results of a previous pass; None to detect slips, and to determine the ends of
        outages. smoothing: record the terms of each step for smoothing.
        """
        initial = initial_state(config)
        history = History(HISTORY_WINDOWS if slips is None else 1)
        super().__init__(config, initial, slips, history, outage_ends)
        self.mounting_check = MountingCheck(config.track_width)
        self.steps = 0
        self.changes = [] if smoothing else None
        self.newest_terms: SmoothingTerms
        self._slip_monitor = SlipMonitor() if slips is None else None
        self._was_replayed = False
        is_aided = config.position_aided or config.encoder_aided
        self.common_scale_sigma = 0.0 if is_aided else config.common_radius_sigma
        self._scale_origin = (0.0, 0.0)
        self.pose_columns = [self._at[entry] for entry in POSE_ENTRIES]
        self._pick_pose = itemgetter(*self.pose_columns)
        self._pose_rows = np.array(self.pose_columns)
        self._pose_elements = np.array(
            [[row * len(self.x) + column for column in self.pose_columns] for row in self.pose_columns]
        )

    @property
    def is_single_pass(self) -> bool:
        """True if a second pass would repeat the steps so far: no slip, and no outage, was in them."""
        return not self._was_replayed and not self.outages.count and not self.slip_schedule.slipping

    def replay(self, number: int) -> UpdateResult:
        """Process the windows from `number` on again, as `WindowProcessor.replay`."""
        self._was_replayed = True
        return super().replay(number)

    def align(self, windows: Sequence[Sequence[Window]]) -> None:
        """Initialise wheel angles and speed from the first windows; `step` follows with each of them."""
        for index, wheel in enumerate(self.wheels):
            wheel.standstill.estimate_initial_noise([row[index] for row in windows])
        for row in windows:
            for wheel, window in zip(self.wheels, row, strict=True):
                wheel.gather_gravity(window)
        for index, wheel in enumerate(self.wheels):
            has_pause = any(
                a[index] is not EMPTY_WINDOW and b[index] is EMPTY_WINDOW for a, b in pairwise(windows)
            )
            if wheel.alignment.is_ready(1) and not has_pause:
                wheel.initialise_angle(self.x, self.p, at_start=True)
                self._update_with_fixed_terms(wheel)
        self._initialise_speed(windows)

    def _initialise_speed(self, windows: Sequence[Sequence[Window]]) -> None:
        """Initialise the speed if the drive starts faster than from standstill."""
        speeds = []
        for index, wheel in enumerate(self.wheels):
            window = next((row[index] for row in windows if row[index].missing == 0.0), None)
            if window is not None and wheel.angle_initialised:
                rate = window.spin / WINDOW_S + self.x[wheel.columns[RATE_BEYOND_RANGE]]
                speeds.append(wheel.geometry.radius * rate)
        if speeds and min(map(abs, speeds)) > _MIN_ROLLING_START_SPEED:
            self.x[self._at[SPEED]] = sum(speeds) / len(speeds)

    def step(self, step: StepInput, alignment_windows: int) -> Pose:
        """Process one step and return the pose at its end.

        alignment_windows: windows of gravity from which a wheel angle is initialised.
        """
        self.windows += step.spans
        if not step.windows:
            self.propagate_over_outage(step.number, step.spans)
            return self._end_step(step.number, MotionState.MOVING, 0.0, 0)
        windows: WheelWindows = tuple(zip(self.wheels, step.windows, strict=True))
        if step.realign:
            self._realign(windows, alignment_windows)
        self.recover_outage()
        received_windows, windows = windows, self._derotate(windows)
        motion_states = detect_wheel_motion(windows, self.x, self.p)
        if self._slip_monitor is not None:
            for index, wheel in enumerate(self.wheels):
                if wheel.slip_detector.is_slipping:
                    self.slip_schedule.mark(index, range(step.number, step.number + 1))
        if self._recovery is not None:
            self._recovery.add(step.number, received_windows, motion_states)
        self.check_standstill(step.number, windows, motion_states)
        self.history.append(StepRecord(step.number, windows, motion_states, list(self.x), self.p.copy()))
        result = self.process_window(step.number, windows, motion_states, step.surface_speeds is not None)
        if self._slip_monitor is not None:
            result = self._slip_monitor.process(self, result)
        if step.surface_speeds is not None:
            self._update_with_surface_speeds(step.surface_speeds)
        if result.motion_state is MotionState.STANDSTILL:
            self._last_standstill = self.windows
        self._count_windows(windows, result)
        check_mounting(self, self.mounting_check, windows, result)
        self.steps += 1
        self.advance(windows)
        if self.steps % WINDOWS_PER_SECOND == 0:  # Rounding causes an asymmetry of 1e-15 in a second.
            self.p[:] = 0.5 * (self.p + self.p.T)
        self.inflate_heading_error()
        return self._end_step(step.number, result.motion_state, result.nis, result.dof)

    def set_pose_exact(self) -> None:
        """Declare the present position and heading exact; their covariance grows from here on.

        Nothing before is processed again: neither a slip nor an outage.
        """
        columns = self.pose_columns[:3]
        self.p[columns, :] = 0.0
        self.p[:, columns] = 0.0
        self.apply(StateReset(columns))
        self._recovery = None
        x, y = (self.x[self._at[entry]] for entry in (X, Y))
        self._heading_inflation = HeadingErrorInflation()
        self._heading_inflation.advance(x, y, 0.0)
        self._scale_origin = (x, y)

    def _end_step(self, number: int, motion_state: MotionState, nis: float, dof: int) -> Pose:
        """Return the pose at the end of window `number`, after recording the terms of its step."""
        inflation = self._heading_inflation.covariance
        x, y, heading, speed, yaw_rate = self._pick_pose(self.x)
        if not self.inertial_speed:
            self.max_speed = max(self.max_speed, abs(speed))
        covariance = _NO_COVARIANCE
        if self.changes is None:
            covariance = self.p.take(self._pose_elements)
            covariance += inflation
            if self.common_scale_sigma:
                offset = x - self._scale_origin[0], y - self._scale_origin[1]
                covariance += common_scale_covariance(self.common_scale_sigma, *offset, speed)
        else:
            self.newest_terms = SmoothingTerms(self.changes, self.p.take(self._pose_rows, axis=0), inflation)
            self.changes = []
        end = (number + 1) * WINDOW_S
        return Pose(
            end, x, y, heading, speed, yaw_rate, covariance, motion_state, nis, dof, self.inertial_speed
        )

    def _realign(self, windows: WheelWindows, alignment_windows: int) -> None:
        """Initialise unknown wheel angles once enough windows of gravity are gathered."""
        for wheel, window in windows:
            if not wheel.angle_initialised and wheel.alignment.is_ready(alignment_windows):
                columns = wheel.initialise_angle(self.x, self.p, at_start=False)
                if columns:
                    self.apply(StateReset(columns))
            wheel.gather_gravity(window)
            wheel.windows_without_angle = 0 if wheel.angle_initialised else wheel.windows_without_angle + 1

    def _derotate(self, windows: WheelWindows) -> WheelWindows:
        """Return the windows with the estimated spin about the axle."""
        derotated = []
        for wheel, window in windows:
            if wheel.angle_initialised:
                window = remove_tilt_rate(self.x, wheel.columns, window)
            new_window, columns = derotate_window(self.x, self.p, wheel, window)
            derotated.append((wheel, new_window))
            if columns or window.all_clipped:
                # The spin tracker has a state of its own, which a replay does not restore.
                self.apply(StateReset(columns))
        return tuple(derotated)

    def _update_with_surface_speeds(self, speeds: tuple[float, float]) -> None:
        """Update with the surface speeds of another odometer, m/s."""
        for side, speed in zip((1.0, -1.0), speeds, strict=True):
            contact = 0.5 * side * self.config.track_width
            row = surface_speed.measure(self.x, self._at, side, contact, speed)
            self.update_with_row(row, self._at, ExternalCorrection)

    def _count_windows(self, windows: WheelWindows, result: UpdateResult) -> None:
        """Update the counts of the wheels."""
        if result.outlier_wheel is not None:
            self.wheels[result.outlier_wheel].counts.outlier_windows += 1
        for (wheel, window), rate in zip(windows, result.rolling_rates, strict=True):
            angle = self.x[wheel.columns[WHEEL_ANGLE]] if wheel.angle_initialised else None
            wheel.counts.add_window(window, rate, angle)
