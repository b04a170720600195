"""One step of the wheel filter, an error-state Kalman filter: a window of each wheel in, a pose out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from operator import itemgetter

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel import mounting_check
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import HEADING, RATE_BEYOND_RANGE, SPEED, TRACK_WIDTH, WHEEL_ANGLE, X, Y
from hubodo.fuse.wheel.heading_error_inflation import HeadingErrorInflation
from hubodo.fuse.wheel.measurement_update import MeasurementUpdate, UpdateResult, WheelWindows
from hubodo.fuse.wheel.measurements import WindowNoise, centripetal, steady, surface_speed
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.outage_log import OutageLog
from hubodo.fuse.wheel.outage_model import OutageModel, vehicle_agility
from hubodo.fuse.wheel.prediction import MotionPrediction, detect_wheel_motion, vehicle_motion
from hubodo.fuse.wheel.propagation import MotionModel
from hubodo.fuse.wheel.rate_beyond_range import derotate_window, reset_misaligned_angle
from hubodo.fuse.wheel.records import POSE_ENTRIES, Innovation, Pose, StepInput, StepRecord
from hubodo.fuse.wheel.rollback import FilterSnapshot, RollbackBuffer
from hubodo.fuse.wheel.slip_schedule import SlipSchedule
from hubodo.fuse.wheel.state import Wheel, initial_state
from hubodo.fuse.wheel.state_vector import StateVector
from hubodo.fuse.wheel.tilt_correction import remove_tilt_rate
from hubodo.fuse.wheel.window import EMPTY_WINDOW, WINDOW_S, Window

_SYMMETRIC = 16
"""Steps after which rounding is taken out of the covariance's symmetry; in so many it is some 1e-15."""

_STARTS = 3.0
"""m/s; a first window that is faster, three sigma of what SPEED begins with, is no start from rest."""

_JUST_NOW = 5
"""Windows within which one wheel may be heard no more before the other, and the vehicle still rests.

Estimated.
"""


class FilterCore(StateVector):
    """State vector, covariance and the step that carries both through a window.

    x: list of the states, in the order of `columns`. p: their covariance. Copies (copy.deepcopy) go their own
    ways.
    """

    def __init__(self, config: WheelConfig, told: SlipSchedule | None = None) -> None:
        """told: which wheels spin by themselves; None: that is to be found."""
        begin = initial_state(config)
        super().__init__(begin)
        self.config = config
        self.mounting_check = mounting_check.MountingCheck(config.track_width)
        self.steps = self.windows = 0
        self.records_steps = False
        self.record = StepRecord([], np.empty(0), [], [], np.empty(0))
        self.slip_schedule = told or SlipSchedule(len(self.wheels))
        self.outages = OutageLog()
        self._shortening = HeadingErrorInflation()
        self.prediction = MotionPrediction(begin.columns, WindowNoise(config.noise, config.radius))
        self.inertial_speed = False
        self._update = MeasurementUpdate(config, begin.columns, wants_residuals=told is None)
        self._motion = MotionModel(config, begin)
        self._over_silence = OutageModel(config, begin)
        self._timeless = False
        self.max_speed = 0.0
        """m/s that the vehicle has gone, by what was measured."""
        self._rested = -_JUST_NOW
        self.pose_columns = [self._at[entry] for entry in POSE_ENTRIES]
        self._of_pose = itemgetter(*self.pose_columns)
        self._covariance = np.array(
            [[row * len(self.x) + column for column in self.pose_columns] for row in self.pose_columns]
        )
        self._searching = told is None
        self._hindsight = RollbackBuffer(WindowNoise(config.noise, config.radius))
        self._tape = len(self.wheels) == 2 and TRACK_WIDTH not in config.priors and not config.position_aided

    def align(self, windows: Sequence[Sequence[Window]]) -> None:
        """Look at the first windows as a whole for the wheel angles; `step` follows with each of them."""
        for index, wheel in enumerate(self.wheels):
            wheel.standstill.estimate_initial_noise([row[index] for row in windows])
        for row in windows:
            for wheel, window in zip(self.wheels, row, strict=True):
                wheel.gather_gravity(window)
        for index, wheel in enumerate(self.wheels):
            pauses = any(
                a[index] is not EMPTY_WINDOW and b[index] is EMPTY_WINDOW for a, b in pairwise(windows)
            )
            if wheel.alignment_count > 0 and wheel.gravity_sum != 0j and not pauses:
                wheel.initialise_angle(self.x, self.p, at_start=True)
                self._look_at_steady(wheel)
        self._begin_rolling(windows)

    def _begin_rolling(self, windows: Sequence[Sequence[Window]]) -> None:
        """Speed where the drive begins faster than anybody starts from rest."""
        rates = [
            wheel.geometry.radius * (row[index].spin / WINDOW_S + self.x[wheel.columns[RATE_BEYOND_RANGE]])
            for index, wheel in enumerate(self.wheels)
            for row in [next((row for row in windows if row[index].missing == 0.0), None)]
            if row is not None and wheel.angle_initialised
        ]
        if rates and min(map(abs, rates)) > _STARTS:
            self.x[self._at[SPEED]] = sum(rates) / len(rates)

    def step(self, step: StepInput, alignment_windows: int) -> Pose:
        """On to the end of a step. needed: windows in which the angle of a wheel is looked for."""
        self.windows += step.spans
        self._timeless = False
        end = (step.number + 1) * WINDOW_S
        if not step.windows:
            return self._pass_silence(end, step.number, step.spans)
        pairs: WheelWindows = tuple(zip(self.wheels, step.windows, strict=True))
        renewed = self._listen(pairs, alignment_windows) if step.realign else []
        told = step.surface_speeds is not None
        if renewed or told:
            self._hindsight.forget()
        pairs = self._carried(pairs, renewed)
        stills = detect_wheel_motion(pairs, self.x, self.p)
        if self._searching:
            for index, wheel in enumerate(self.wheels):
                if wheel.slip_detector.is_slipping:
                    self.slip_schedule.mark(index, range(step.number, step.number + 1))
        if self.outages.may_have_been_stationary:
            self._hindsight.forget()
            lost = self.slip_schedule.slipping_wheels(step.number)
            self.outages.check_standstill(self.p, self._at, pairs, vehicle_motion(stills, lost))
        if self._searching:
            self._hindsight.keep(FilterSnapshot(step.number, pairs, stills, list(self.x), self.p.copy()))
        found = self.process_window(step.number, pairs, stills, renewed, told)
        if self._searching:
            found = self._hindsight.judge(self, found)
        if step.surface_speeds is not None:
            self._roll(step.surface_speeds)
        if found.motion_state is MotionState.STANDSTILL:
            self._rested = self.windows
        self._watch(pairs, found)
        self.steps += 1
        self.advance(pairs)
        if self.steps % _SYMMETRIC == 0:
            self.p[:] = 0.5 * (self.p + self.p.T)
        self._go()
        if self.records_steps:
            self.record = self.record._replace(heading_inflation=self._shortening.covariance)
        return self._pose(end, found.motion_state, found.nis, found.dof)

    def advance(self, pairs: WheelWindows) -> None:
        """To the end of a window that has been worked in."""
        self._motion.advance(self.x, self.p, pairs)

    def transition(self) -> Array:
        """Derivatives of the states at the end of the last step by those after its measurements, (n, n)."""
        return np.eye(len(self.x)) if self._timeless else self._motion.transition()

    def update_with_position(self, new: Innovation) -> None:
        """Works a position in."""
        # Going back would lose it.
        self._hindsight.forget()
        weight = np.linalg.solve(new.s, new.ph.T)
        self.apply_correction(new.z @ weight, new.ph @ weight)

    def _go(self) -> None:
        """The way of a step is as much shorter as its heading is not known; what is told needs no way."""
        if not self.config.position_aided:
            heading = self._at[HEADING]
            self._shortening.advance(self.x[self._at[X]], self.x[self._at[Y]], self.p.item(heading, heading))

    def _pose(self, end: float, stillness: MotionState, nis: float, degrees: int) -> Pose:
        covariance = self.p.take(self._covariance)
        x, y, heading, speed, yaw_rate = self._of_pose(self.x)
        if not self.inertial_speed:
            self.max_speed = max(self.max_speed, abs(speed))
        covariance[:2, :2] += self._shortening.covariance
        return Pose(
            end, x, y, heading, speed, yaw_rate, covariance, stillness, nis, degrees, self.inertial_speed
        )

    # -- silence --------------------------------------------------------------------------------------------

    def _pass_silence(self, end: float, number: int, windows: int) -> Pose:
        """Nothing was heard of any wheel: what vehicles do meanwhile."""
        stood = self.windows - windows - self._rested < _JUST_NOW
        seconds = windows * WINDOW_S
        passed, turned = self._over_silence.advance(
            self.x, self.p, seconds, vehicle_agility(self.max_speed), stood
        )
        forces = [wheel.standstill.force for wheel in self.wheels]
        self.outages.add_outage(end - seconds, end, turned, forces if stood else None)
        self._hindsight.forget()
        self.prediction.clear_force()
        self.inertial_speed = False
        self._go()
        for wheel in self.wheels:
            wheel.mark_missing(windows)
            wheel.standstill.clear()
            wheel.slip_detector.end_by_outage(number)
        if self.records_steps:
            after = list(self.x), self.p.copy()
            self.record = StepRecord(
                *after, [], *after, outage_transition=passed, heading_inflation=self._shortening.covariance
            )
        self._timeless = True
        return self._pose(end, MotionState.MOVING, 0.0, 0)

    # -- one window -----------------------------------------------------------------------------------------

    def _listen(self, pairs: WheelWindows, needed: int) -> list[int]:
        """The places of the states that were begun anew with wheel angles that were found."""
        found = []
        for wheel, window in pairs:
            if not wheel.angle_initialised and wheel.alignment_count >= needed and wheel.gravity_sum != 0j:
                found += wheel.initialise_angle(self.x, self.p, at_start=False)
            wheel.gather_gravity(window)
        return found

    def _carried(self, pairs: WheelWindows, renewed: list[int]) -> WheelWindows:
        """The windows with the spin that they are believed to have; adds to `renewed`."""
        made = []
        for wheel, window in pairs:
            turned, anew = derotate_window(self.x, self.p, wheel, remove_tilt_rate(self.x, wheel, window))
            made.append((wheel, turned))
            renewed += anew
            if anew or window.all_clipped:
                # The spin that a clipped gyro does not show is found once, and never gone back to.
                self._hindsight.forget()
        return tuple(made)

    def process_window(
        self,
        number: int,
        pairs: WheelWindows,
        stills: Sequence[MotionState],
        renewed: Sequence[int] = (),
        told: bool = False,
    ) -> UpdateResult:
        """Takes the states to a window, and the window into the states.

        renewed: the states that were begun anew before. told: whether another odometer tells what the wheels
        do.
        """
        stillness, carries = MotionState.MOVING, False
        lost = self.slip_schedule.slipping_wheels(number)
        for wheel, away in zip(self.wheels, lost, strict=True):
            wheel.is_slipping = away
        if any(lost):
            carries = not any(wheel.measures_speed(window) for wheel, window in pairs)
        if number in self.slip_schedule.speed_variance:
            speed = self._at[SPEED]
            self.p[speed, speed] += self.slip_schedule.speed_variance[number]
        # The window in which a wheel is back tells how wrong the speed was that was carried until then.
        carry, self.inertial_speed = carries or self.inertial_speed, carries
        if not carry:
            stillness = vehicle_motion(stills, lost)
        self.prediction.predict(self.x, self.p, pairs, stillness, carry, told, self.max_speed)
        prior = (list(self.x), self.p.copy()) if self.records_steps else None
        found = self._update.update(self.x, self.p, pairs, stillness)
        self.x, self.p = found.x, found.p
        anew = [*renewed, *self.prediction.reset_states]
        for wheel, window in pairs:
            self._look_at_steady(wheel)
            if window.all_clipped and window.force_clipped == 0.0 and not wheel.spin_tracker.is_observed:
                self._feel_spin(wheel, window)
            if window.all_clipped and wheel.angle_initialised:
                anew += reset_misaligned_angle(self.x, self.p, wheel, window)
        if self._tape:
            self._ask_tape()
        if prior is not None:
            made = self.prediction.speed_row
            by = None if made is None else (self._at[SPEED], made)
            self.record = StepRecord(*prior, anew, list(self.x), self.p.copy(), by)
        return found

    # -- what else the windows say --------------------------------------------------------------------------

    def _ask_tape(self) -> None:
        """Tells the track once what the vehicle file says, if the drive makes it likely."""
        place = self._at[TRACK_WIDTH]
        error, variance = self.x[place], self.p.item(place, place)
        noise = mounting_check.track_width_test(error, variance, TRACK_WIDTH.prior)
        if noise is None:
            return
        self._tape = False
        self._hindsight.forget()
        if math.isfinite(noise):
            ph = self.p[place].copy()
            s = variance + noise
            self.apply_correction(ph * (-error / s), np.outer(ph, ph / s))

    def _look_at_steady(self, wheel: Wheel) -> None:
        """What the search of a clipped spin has shown besides; before the first window if it begins so."""
        seen, wheel.steady_terms = wheel.steady_terms, None
        if seen is not None:
            for row in range(steady.N_ROWS):
                self.update_with_row(steady.measure(self.x, wheel.columns, seen)[row], wheel.columns)

    def _feel_spin(self, wheel: Wheel, window: Window) -> None:
        wheel.view.linearise(self.x, window, resting=False)
        row = centripetal.measure(wheel.view, self.config.noise)
        if row is not None:
            self.update_with_row(row, wheel.columns)

    def _roll(self, speeds: tuple[float, float]) -> None:
        """What another odometer says of the wheels' surfaces."""
        for side, speed in zip((1.0, -1.0), speeds, strict=True):
            contact = 0.5 * side * self.config.track_width
            self.update_with_row(surface_speed.measure(self.x, self._at, side, contact, speed), self._at)

    def _watch(self, pairs: WheelWindows, found: UpdateResult) -> None:
        if found.outlier_wheel is not None:
            self.wheels[found.outlier_wheel].outlier_windows += 1
        for (wheel, window), rate in zip(pairs, found.rolling_rates, strict=True):
            wheel.count_window(window, rate, self.x[wheel.columns[WHEEL_ANGLE]])
        if (
            len(pairs) == 2
            and self.mounting_check.is_undecided
            and all(
                wheel.angle_initialised and window.missing == 0.0 and not wheel.is_slipping
                for wheel, window in pairs
            )
            and not any(window.spin_clipped + window.across_clipped for _, window in pairs)
        ):
            self._compare(found.rolling_rates, found.yaw_rates)

    def _compare(self, rates: Sequence[float], yaws: Sequence[float]) -> None:
        """Two wheels with the yaw rates that their gyros feel: are they the axle that was declared?"""
        speeds = [rate * wheel.geometry.radius for rate, wheel in zip(rates, self.wheels, strict=True)]
        order = (0, 1) if self.wheels[0].geometry.side > 0 else (1, 0)
        left, right = (speeds[index] for index in order)
        blamed = self.mounting_check.add((yaws[order[0]], yaws[order[1]]), left, right)
        if blamed is None:
            return
        # Up to here the wrong wheel may have been believed.
        lost = 2.0 * max(abs(way) for way in self.mounting_check.wheel_distances)
        for place in (self._at[X], self._at[Y]):
            self.p[place, place] += lost * lost
        self._hindsight.forget()
        for wheel in self.wheels:
            wheel.speed_trusted &= blamed != mounting_check.BOTH_WHEELS and blamed != wheel.geometry.side
            wheel.is_used = self.mounting_check.usable_side in (0.0, wheel.geometry.side)
            if self.mounting_check.other_wheel_steers:
                wheel.speed_trusted = wheel.is_used
            if wheel.is_used and self.mounting_check.sides_swapped:
                wheel.speed_trusted = True
                wheel.swap_side()
