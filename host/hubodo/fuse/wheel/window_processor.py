"""Processing of one window: prediction, measurement update, spin beyond the gyro's range, track width."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import SPEED, TRACK_WIDTH
from hubodo.fuse.wheel.measurement_update import MeasurementUpdate, UpdateResult
from hubodo.fuse.wheel.measurements import WindowNoise, centripetal, gravity_phase, steady
from hubodo.fuse.wheel.motion_model import MotionModel
from hubodo.fuse.wheel.motion_prediction import MotionPrediction, vehicle_motion
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.mounting_check import track_width_test
from hubodo.fuse.wheel.rate_beyond_range import reset_misaligned_angle
from hubodo.fuse.wheel.records import History, SlipSchedule, StateTransition, WheelWindows
from hubodo.fuse.wheel.state_vector import ExternalCorrection, InitialState, StateVector
from hubodo.fuse.wheel.wheel import Wheel, WheelMode
from hubodo.fuse.wheel.window import Window


class WindowProcessor(StateVector):
    """The states, and the operations of one window, which a replay repeats.

    Attributes
    ----------
    slip_schedule : which wheels slip in which windows.
    inertial_speed : True if only accelerometers measured the speed in the last window.
    max_speed : m/s reached so far, as measured by wheels.
    """

    def __init__(
        self, config: WheelConfig, initial: InitialState, slips: SlipSchedule | None, history: History
    ) -> None:
        super().__init__(initial, history)
        self.config = config
        self.slip_schedule = slips or SlipSchedule(len(self.wheels))
        self.inertial_speed = False
        self.max_speed = 0.0
        self.noise = WindowNoise(config.noise, config.radius)
        self._prediction = MotionPrediction(initial.columns, self.noise)
        self._update = MeasurementUpdate(config, initial.columns, wants_residuals=slips is None)
        self._motion = MotionModel(config, initial)
        self._tests_track_width = (
            len(self.wheels) == 2 and TRACK_WIDTH not in config.priors and not config.position_aided
        )

    def process_window(
        self,
        number: int,
        windows: WheelWindows,
        motion_states: Sequence[MotionState],
        has_surface_speeds: bool = False,
    ) -> UpdateResult:
        """Predict the states for a window and update them with its measurements.

        has_surface_speeds: another odometer measures this window too.
        """
        is_slipping = self.slip_schedule.slipping_wheels(number)
        for wheel, slips in zip(self.wheels, is_slipping, strict=True):
            wheel.is_slipping = slips
        inertial_now = any(is_slipping) and not any(
            wheel.mode(window) is WheelMode.ROLLING for wheel, window in windows
        )
        if number in self.slip_schedule.speed_variance:
            speed = self._at[SPEED]
            self.p[speed, speed] += self.slip_schedule.speed_variance[number]
        # The first window in which a wheel rolls again measures the error of the inertial speed up to then.
        is_inertial, self.inertial_speed = inertial_now or self.inertial_speed, inertial_now
        state = MotionState.MOVING if is_inertial else vehicle_motion(motion_states, is_slipping)
        self._prediction.predict(
            self.x, self.p, windows, state, is_inertial, has_surface_speeds, self.max_speed
        )
        self.record_reset(self._prediction.reset_states)
        if self._prediction.speed_row is not None:
            self.record_change(StateTransition.of_rows([self._at[SPEED]], self._prediction.speed_row))
        result = self._update.update(self.x, self.p, windows, state, self.changes is not None)
        self.x, self.p = result.x, result.p
        if result.terms is not None:
            self.record_change(result.terms)
        for wheel, window in windows:
            if wheel.fixed_terms is not None:
                self._update_with_fixed_terms(wheel)
            if window.all_clipped:
                self._update_with_gravity(wheel, window)
        if self._tests_track_width:
            self._test_track_width()
        return result

    def _update_with_gravity(self, wheel: Wheel, window: Window) -> None:
        """Update with centripetal force and gravity of a window whose gyro is clipped all the time."""
        if window.force_clipped == 0.0 and not wheel.spin_tracker.is_observed:
            self._update_with_centripetal(wheel, window)
        if not wheel.angle_initialised:
            return
        if window.gravity_angle is not None:
            wheel.view.linearise(self.x, window, is_stationary=False)
            self.update_with_row(gravity_phase.measure(wheel.view, window.gravity_angle), wheel.columns)
        self.record_reset(reset_misaligned_angle(self.x, self.p, wheel, window))

    def advance(self, windows: WheelWindows) -> None:
        """Propagate the states to the end of a processed window."""
        self._motion.advance(self.x, self.p, windows)
        if self.changes is not None:
            self.changes.append(self._motion.transition())

    def replay(self, number: int) -> UpdateResult:
        """Restore the states at the start of window `number` and process the windows since then again.

        They are processed with the present slip schedule. Poses already returned do not change.
        """
        records = self.history.pop_since(number)
        self.x, self.p = list(records[0].start_x), records[0].start_p.copy()
        self.inertial_speed = self.slip_schedule.all_slipping_before(records[0].number)
        self._prediction.clear_force()
        for index, record in enumerate(records):
            if index:
                self.advance(records[index - 1].windows)
            self.history.append(record._replace(start_x=list(self.x), start_p=self.p.copy()))
            result = self.process_window(record.number, record.windows, record.motion_states)
        return result

    def _test_track_width(self) -> None:
        """Update the track width once with the declared one, if the drive confirms a careful measurement."""
        column = self._at[TRACK_WIDTH]
        error, variance = self.x[column], self.p.item(column, column)
        noise = track_width_test(error, variance, TRACK_WIDTH.prior)
        if noise is None:
            return
        self._tests_track_width = False
        if math.isfinite(noise):
            self.update_with_row((-error, noise, {TRACK_WIDTH: 1.0}), self._at, ExternalCorrection)

    def _update_with_fixed_terms(self, wheel: Wheel) -> None:
        """Update with the node-fixed terms of a spin search, if there are any."""
        terms, wheel.fixed_terms = wheel.fixed_terms, None
        if terms is not None:
            for row in range(steady.N_ROWS):
                rows = steady.measure(self.x, wheel.columns, terms, self.config.noise)
                self.update_with_row(rows[row], wheel.columns)

    def _update_with_centripetal(self, wheel: Wheel, window: Window) -> None:
        """Update with the centripetal force of a clipped window."""
        wheel.view.linearise(self.x, window, is_stationary=False)
        row = centripetal.measure(wheel.view, self.config.noise)
        if row is not None:
            self.update_with_row(row, wheel.columns)
