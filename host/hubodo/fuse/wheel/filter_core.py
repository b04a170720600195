"""Core of the wheel filter, an error-state Kalman filter: one step from windows of all wheels to a pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from operator import itemgetter

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.axle_rate import remove_tilt_rate
from hubodo.fuse.wheel.config import GATE_SIGMA, WheelConfig
from hubodo.fuse.wheel.entries import HEADING, RATE_BEYOND_RANGE, SPEED, WHEEL_ANGLE, X, Y
from hubodo.fuse.wheel.free_motion import MotionSigmas, vehicle_motion_sigmas
from hubodo.fuse.wheel.measurement_update import UpdateResult
from hubodo.fuse.wheel.measurements import surface_speed
from hubodo.fuse.wheel.motion_model import HeadingErrorInflation
from hubodo.fuse.wheel.motion_prediction import detect_wheel_motion, vehicle_motion
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.mounting_check import MountingCheck
from hubodo.fuse.wheel.mounting_monitor import check_mounting
from hubodo.fuse.wheel.outage_bridge import OutageBridge, OutageEnd
from hubodo.fuse.wheel.outage_log import OutageLog
from hubodo.fuse.wheel.outage_model import OutageModel
from hubodo.fuse.wheel.outage_recovery import OutageRecovery
from hubodo.fuse.wheel.rate_beyond_range import derotate_window
from hubodo.fuse.wheel.records import (
    POSE_ENTRIES,
    History,
    Pose,
    SmoothingTerms,
    StateTransition,
    StepInput,
    StepRecord,
    WheelWindows,
    common_scale_covariance,
)
from hubodo.fuse.wheel.slip_monitor import HISTORY_WINDOWS, SlipMonitor
from hubodo.fuse.wheel.slip_schedule import SlipSchedule
from hubodo.fuse.wheel.state_vector import ExternalCorrection, StateReset, initial_state
from hubodo.fuse.wheel.window import EMPTY_WINDOW, WINDOW_S, WINDOWS_PER_SECOND, Window
from hubodo.fuse.wheel.window_processor import WindowProcessor

_SYMMETRISATION_STEPS = 16
"""Steps between symmetrisations of the covariance; rounding causes an asymmetry of 1e-15 over this number."""

_MIN_ROLLING_START_SPEED = GATE_SIGMA * SPEED.prior
"""m/s; a first window that is faster is not a start from standstill."""

_STANDSTILL_MEMORY_WINDOWS = WINDOWS_PER_SECOND
"""Windows after the last standstill in which an outage still counts as starting at standstill: one wheel may
be lost so long before the other."""


class FilterCore(WindowProcessor):
    """State of the wheel filter and its steps.

    Attributes
    ----------
    windows, steps : number of windows so far, and number of windows with samples.
    mounting_check, outages : accumulated evidence on the mounting, and the outages so far.
    pose_columns : columns of the states of a pose.
    outage_ends : ends of outages whose motion the wheel angles determined, by number of the last window.
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
        super().__init__(config, initial, slips, History(HISTORY_WINDOWS if slips is None else 1))
        self.mounting_check = MountingCheck(config.track_width)
        self.outages = OutageLog()
        self.steps = self.windows = 0
        self.changes = [] if smoothing else None
        self.newest_terms: SmoothingTerms
        self._slip_monitor = SlipMonitor() if slips is None else None
        self._was_replayed = False
        self.outage_ends = dict(outage_ends or {})
        self._recovery: OutageRecovery | None = None
        self._recovers_outages = slips is None and not config.position_aided and not config.encoder_aided
        self._heading_inflation = HeadingErrorInflation()
        is_aided = config.position_aided or config.encoder_aided
        self.common_scale_sigma = 0.0 if is_aided else config.common_radius_sigma
        self._scale_origin = (0.0, 0.0)
        self._outage_model = OutageModel(config, initial)
        self._last_standstill = -_STANDSTILL_MEMORY_WINDOWS
        self.pose_columns = [self._at[entry] for entry in POSE_ENTRIES]
        self._pick_pose = itemgetter(*self.pose_columns)
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
            if wheel.alignment_count > 0 and wheel.gravity_sum != 0j and not has_pause:
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
            return self._step_over_outage(step.number, step.spans)
        windows: WheelWindows = tuple(zip(self.wheels, step.windows, strict=True))
        if step.realign:
            self._realign(windows, alignment_windows)
        if self._recovery is not None:
            self._recover_outage(self._recovery)
        received_windows, windows = windows, self._derotate(windows)
        motion_states = detect_wheel_motion(windows, self.x, self.p)
        if self._slip_monitor is not None:
            for index, wheel in enumerate(self.wheels):
                if wheel.slip_detector.is_slipping:
                    self.slip_schedule.mark(index, range(step.number, step.number + 1))
        if self._recovery is not None:
            self._recovery.add(step.number, received_windows, motion_states)
        if self.outages.may_have_been_stationary:
            self._check_standstill(step.number, windows, motion_states)
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
        if self.steps % _SYMMETRISATION_STEPS == 0:
            self.p[:] = 0.5 * (self.p + self.p.T)
        self._inflate_heading_error()
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

    def _inflate_heading_error(self) -> None:
        """Add the step to the second-order heading error; measured positions do not need it."""
        if not self.config.position_aided:
            heading = self._at[HEADING]
            self._heading_inflation.advance(
                self.x[self._at[X]], self.x[self._at[Y]], self.p.item(heading, heading)
            )

    def _end_step(self, number: int, motion_state: MotionState, nis: float, dof: int) -> Pose:
        """Return the pose at the end of window `number`, after recording the terms of its step."""
        if self.changes is not None:
            self.newest_terms = SmoothingTerms(
                self.changes, self.p[self.pose_columns], self._heading_inflation.covariance
            )
            self.changes = []
        end = (number + 1) * WINDOW_S
        covariance = self.p.take(self._pose_elements)
        x, y, heading, speed, yaw_rate = self._pick_pose(self.x)
        if not self.inertial_speed:
            self.max_speed = max(self.max_speed, abs(speed))
        covariance[:2, :2] += self._heading_inflation.covariance
        if self.common_scale_sigma:
            origin_x, origin_y = self._scale_origin
            covariance += common_scale_covariance(self.common_scale_sigma, x - origin_x, y - origin_y, speed)
        return Pose(
            end, x, y, heading, speed, yaw_rate, covariance, motion_state, nis, dof, self.inertial_speed
        )

    def _step_over_outage(self, number: int, spans: int) -> Pose:
        """Propagate the states over an outage of all wheels that ends with window `number`."""
        was_stationary = self.windows - spans - self._last_standstill < _STANDSTILL_MEMORY_WINDOWS
        end, seconds = (number + 1) * WINDOW_S, spans * WINDOW_S
        motion_sigmas, end_of_outage = vehicle_motion_sigmas(self.max_speed), self.outage_ends.get(number)
        self._recovery = None
        if end_of_outage is not None:
            transition = self._bridge_outage(seconds, motion_sigmas, end_of_outage)
            heading_variance = 0.0
        else:
            can_recover = self._recovers_outages and not was_stationary
            if can_recover and OutageRecovery.is_possible(self.wheels, seconds):
                self._recovery = OutageRecovery(
                    number,
                    seconds,
                    motion_sigmas,
                    list(self.x),
                    self.p.copy(),
                    replace(self._heading_inflation),
                )
            transition, heading_variance = self._outage_model.advance(
                self.x, self.p, seconds, motion_sigmas, was_stationary
            )
        forces = [wheel.standstill.force for wheel in self.wheels]
        self.outages.add_outage(end - seconds, end, heading_variance, forces if was_stationary else None)
        self.apply(StateReset(()))
        self._prediction.clear_force()
        self.inertial_speed = False
        self._inflate_heading_error()
        for wheel in self.wheels:
            wheel.mark_missing(spans)
            wheel.standstill.clear()
            wheel.slip_detector.end_by_outage(number)
            if end_of_outage is not None:
                wheel.resume_angle()
        self.record_change(StateTransition.of_rows(range(len(self.x)), transition))
        return self._end_step(number, MotionState.MOVING, 0.0, 0)

    def _bridge_outage(self, seconds: float, motion_sigmas: MotionSigmas, end: OutageEnd) -> Array:
        """Propagate the states over an outage whose end is known; return the transition (n, n)."""
        noise = self.config.noise
        bridge = OutageBridge(self.x, self._at, self.wheels, seconds, motion_sigmas, end)
        after = bridge.solve(noise.road_roughness, noise.lateral_slip)
        self._outage_model.bridge(self.x, self.p, seconds, after.x, after.transition, after.noise)
        for wheel in self.wheels:
            wheel.view.yaw_change = 0.0
        return after.transition

    def _recover_outage(self, recovery: OutageRecovery) -> None:
        """Bridge a past outage once all wheel angles are known, and reprocess the windows since then."""
        if recovery.is_over():
            self._recovery = None
            return
        end = recovery.outage_end(self.x) if all(it.angle_initialised for it in self.wheels) else None
        if end is None:
            return
        self._recovery, self.outage_ends[recovery.number] = None, end
        self.x, self.p, self._heading_inflation = recovery.x, recovery.p, recovery.inflation
        self._bridge_outage(recovery.seconds, recovery.motion_sigmas, end)
        # Earlier records of these windows belong to the states without the wheel angles.
        self.apply(StateReset(()))
        self._prediction.clear_force()
        self.inertial_speed = False
        self._inflate_heading_error()
        for number, received_windows, motion_states in recovery.steps:
            windows = tuple(
                (wheel, remove_tilt_rate(self.x, wheel.columns, window)) for wheel, window in received_windows
            )
            self.history.append(StepRecord(number, windows, motion_states, list(self.x), self.p.copy()))
            self.process_window(number, windows, motion_states)
            self.advance(windows)
            self._inflate_heading_error()

    def _realign(self, windows: WheelWindows, alignment_windows: int) -> None:
        """Initialise unknown wheel angles once enough windows of gravity are gathered."""
        for wheel, window in windows:
            is_ready = wheel.alignment_count >= alignment_windows and wheel.gravity_sum != 0j
            if not wheel.angle_initialised and is_ready:
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

    def _check_standstill(
        self, number: int, windows: WheelWindows, motion_states: Sequence[MotionState]
    ) -> None:
        """Keep the heading of a vehicle that stands still before and after an outage."""
        state = vehicle_motion(motion_states, self.slip_schedule.slipping_wheels(number))
        change = self.outages.check_standstill(windows, state)
        if change:
            self.inflate({HEADING: change})

    def _update_with_surface_speeds(self, speeds: tuple[float, float]) -> None:
        """Update with the surface speeds of another odometer, m/s."""
        for side, speed in zip((1.0, -1.0), speeds, strict=True):
            contact = 0.5 * side * self.config.track_width
            row = surface_speed.measure(self.x, self._at, side, contact, speed)
            self.update_with_row(row, self._at, ExternalCorrection)

    def _count_windows(self, windows: WheelWindows, result: UpdateResult) -> None:
        """Update the counts of the wheels."""
        if result.outlier_wheel is not None:
            self.wheels[result.outlier_wheel].outlier_windows += 1
        for (wheel, window), rate in zip(windows, result.rolling_rates, strict=True):
            wheel.count_window(window, rate, self.x[wheel.columns[WHEEL_ANGLE]])
