"""Outages of all wheels: propagation over them, recovery of their motion, standstill across them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from hubodo.arrays import Array
from hubodo.fuse.wheel.axle_rate import remove_tilt_rate
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import HEADING, X, Y
from hubodo.fuse.wheel.free_motion import MotionSigmas, vehicle_motion_sigmas
from hubodo.fuse.wheel.motion_model import HeadingErrorInflation
from hubodo.fuse.wheel.motion_prediction import vehicle_motion
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.outage_bridge import OutageBridge, OutageEnd
from hubodo.fuse.wheel.outage_log import OutageLog
from hubodo.fuse.wheel.outage_model import OutageModel
from hubodo.fuse.wheel.outage_recovery import OutageRecovery
from hubodo.fuse.wheel.records import History, SlipSchedule, StateTransition, StepRecord, WheelWindows
from hubodo.fuse.wheel.state_vector import InitialState, StateReset
from hubodo.fuse.wheel.window import WINDOW_S, WINDOWS_PER_SECOND
from hubodo.fuse.wheel.window_processor import WindowProcessor

_STANDSTILL_MEMORY_WINDOWS = WINDOWS_PER_SECOND
"""Windows after the last standstill in which an outage still counts as starting at standstill: one wheel may
be lost so long before the other."""


class OutageProcessor(WindowProcessor):
    """The states, and the operations of an outage.

    Attributes
    ----------
    windows : number of windows so far, those of outages included.
    outages : the outages so far.
    outage_ends : ends of outages whose motion the wheel angles determined, by number of the last window.
    """

    def __init__(
        self,
        config: WheelConfig,
        initial: InitialState,
        slips: SlipSchedule | None,
        history: History,
        outage_ends: Mapping[int, OutageEnd] | None,
    ) -> None:
        super().__init__(config, initial, slips, history)
        self.windows = 0
        self.outages = OutageLog()
        self.outage_ends = dict(outage_ends or {})
        self._recovery: OutageRecovery | None = None
        self._recovers_outages = slips is None and not config.position_aided and not config.encoder_aided
        self._heading_inflation = HeadingErrorInflation()
        self._outage_model = OutageModel(config, initial)
        self._last_standstill = -_STANDSTILL_MEMORY_WINDOWS

    def inflate_heading_error(self) -> None:
        """Add the step to the second-order heading error; measured positions do not need it."""
        if not self.config.position_aided:
            heading = self._at[HEADING]
            self._heading_inflation.advance(
                self.x[self._at[X]], self.x[self._at[Y]], self.p.item(heading, heading)
            )

    def propagate_over_outage(self, number: int, spans: int) -> None:
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
        self.inflate_heading_error()
        for wheel in self.wheels:
            wheel.mark_missing(spans)
            wheel.standstill.clear()
            wheel.slip_detector.end_by_outage(number)
            if end_of_outage is not None:
                wheel.resume_angle()
        self.record_change(StateTransition.of_rows(range(len(self.x)), transition))

    def _bridge_outage(self, seconds: float, motion_sigmas: MotionSigmas, end: OutageEnd) -> Array:
        """Propagate the states over an outage whose end is known; return the transition (n, n)."""
        noise = self.config.noise
        bridge = OutageBridge(self.x, self._at, self.wheels, seconds, motion_sigmas, end)
        after = bridge.solve(noise.road_roughness, noise.lateral_slip)
        self._outage_model.bridge(self.x, self.p, seconds, after.x, after.transition, after.noise)
        for wheel in self.wheels:
            wheel.view.yaw_change = 0.0
        return after.transition

    def recover_outage(self) -> None:
        """Bridge the last outage once all wheel angles are known, and reprocess the windows since then."""
        recovery = self._recovery
        if recovery is None:
            return
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
        self.inflate_heading_error()
        for number, received_windows, motion_states in recovery.steps:
            windows = tuple(
                (wheel, remove_tilt_rate(self.x, wheel.columns, window)) for wheel, window in received_windows
            )
            self.history.append(StepRecord(number, windows, motion_states, list(self.x), self.p.copy()))
            self.process_window(number, windows, motion_states)
            self.advance(windows)
            self.inflate_heading_error()

    def check_standstill(
        self, number: int, windows: WheelWindows, motion_states: Sequence[MotionState]
    ) -> None:
        """Keep the heading of a vehicle that stands still before and after an outage."""
        if not self.outages.may_have_been_stationary:
            return
        state = vehicle_motion(motion_states, self.slip_schedule.slipping_wheels(number))
        change = self.outages.check_standstill(windows, state)
        if change:
            self.inflate({HEADING: change})
