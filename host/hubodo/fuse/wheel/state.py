"""Where the wheel filter starts: its states, what is known of them, and the book kept for each wheel."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, field, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import (
    CAMBER,
    HEADING,
    RATE_BEYOND_RANGE,
    TIME_OFFSET,
    WHEEL_ANGLE,
    WHEEL_ENTRIES,
    Entry,
    StateLayout,
)
from hubodo.fuse.wheel.measurements import LinearisedWindow, WheelGeometry
from hubodo.fuse.wheel.measurements.steady import NodeFixedTerms
from hubodo.fuse.wheel.motion_state import StandstillDetector
from hubodo.fuse.wheel.slip_detector import SlipDetector
from hubodo.fuse.wheel.spin_search import SpinTracker, find_spin
from hubodo.fuse.wheel.window import EMPTY_WINDOW, WINDOW_S, Window
from hubodo.vehicle import side_sign

_LOST_ANGLE = 0.7
"""rad by which gravity may seem to have turned over a gap; beyond it the angle is found anew.

Twice what hard braking tilts it by (WHEEL_ANGLE's prior), estimated.
"""

_LOOK = 3
"""Windows after a gap that are looked at for it: a bump fills one. Estimated."""

_FOUND_EXCESS = 1.0
"""rad/s, 1 sigma of a spin that was searched for; the vehicle may brake unevenly meanwhile. Estimated."""

_OLD, _NEW = 0.8, 0.2
"""Shares that the direction of gravity before a gap keeps and takes up from window to window.

Half a second of memory, shorter than a manoeuvre and longer than a bump. Estimated.
"""

_ENOUGH, _TURNING = 300, 1.0
"""How many windows, with a wheel faster than so many rad/s, tell whether gravity turns with it.

Half a minute. Estimated.
"""

MAX_MISSING_SHARE = 0.5
"""Share of a window without samples from which on it says nothing at all."""


@dataclass
class Wheel:
    """One wheel: where its entries stand in the state, and counts that a report is made of.

    at: column of each entry, its own and the vehicle's. view: its present window, for the measurements.
    joined: its angle is known. trusted: its speed is used; part: anything of it is. astray: windows in
    a row, arm_known: m², of the lever arm before a gyro clipped; see excess.py. steady: what the search of a
    spin has shown besides, to be worked in. grip: whether it rolls with
    the road; away: whether it is taken not to in the present window. turned: rad in all, forwards: rad net.
    upright: sum over `moving` windows of the force that points up, in units of g. slips, clipped,
    unheard_in_all: windows. lost: times that the wheel angle was lost over a gap.
    """

    name: str
    node: WheelNode
    geometry: WheelGeometry
    standstill: StandstillDetector
    columns: dict[Entry, int]
    view: LinearisedWindow
    spin_tracker: SpinTracker
    slip_detector: SlipDetector = field(default_factory=SlipDetector)
    angle_initialised: bool = False
    is_slipping: bool = False
    speed_trusted: bool = True
    misaligned_windows: int = 0
    steady_terms: NodeFixedTerms | None = None
    arm_variances: tuple[float, float] | None = None
    is_used: bool = True
    alignment_count: int = 0
    gravity_sum: complex = 0j
    axial_sum: float = 0.0
    alignment_start_angle: float = 0.0
    alignment_end_angle: float = 0.0
    turned_angle: float = 0.0
    net_angle: float = 0.0
    upright_sum: float = 0.0
    upright_count: int = 0
    outlier_windows: int = 0
    clipped_windows: int = 0
    missing_windows: int = 0
    angle_losses: int = 0
    _heard: list[Window] = field(default_factory=list)
    _before: complex = 0j
    _after: complex = 0j
    _looked: int | None = None

    def swap_side(self) -> None:
        """To the other side of the vehicle."""
        seen = self.geometry
        self.geometry = replace(seen, contact_y=-seen.contact_y)
        self.view = LinearisedWindow(self.geometry, self.columns)

    def measures_speed(self, window: Window) -> bool:
        """Whether the window tells the speed of the vehicle."""
        return (
            self.angle_initialised
            and self.speed_trusted
            and not self.is_slipping
            and window.missing < MAX_MISSING_SHARE
        )

    def count_window(self, window: Window, rate: float, angle: float) -> None:
        """Counts for the report; rate: rad/s at which it turns, angle: at the beginning of the window."""
        self.turned_angle += abs(rate) * WINDOW_S
        self.net_angle += rate * WINDOW_S
        self.clipped_windows += window.spin_clipped > 0.0
        if (
            self.upright_count < _ENOUGH
            and abs(rate) > _TURNING
            and self.angle_initialised
            and window.force_clipped == 0.0
        ):
            middle = cmath.exp(1j * (angle + 0.5 * rate * WINDOW_S))
            self.upright_sum += (window.force * middle).real / (STANDARD_GRAVITY * WINDOW_S)
            self.upright_count += 1

    def gather_gravity(self, window: Window) -> None:
        """Gathers gravity, carried along with the spin, until the wheel angle can be read from it."""
        if window is EMPTY_WINDOW:
            self.mark_missing(1)
            return
        if window.missing > 0.5:
            self.missing_windows += 1
            self._after, self._looked = 0j, 0
            return
        if self.angle_initialised:
            self._compare(window)
            return
        if self.alignment_count == 0:
            self.alignment_start_angle = window.clock_angle - 0.5 * window.spin
        self.alignment_count += 1
        self._heard.append(window)
        self.gravity_sum += window.force * cmath.exp(1j * window.clock_angle)
        self.axial_sum += window.axial
        self.alignment_end_angle = window.clock_angle + 0.5 * window.spin

    def mark_missing(self, windows: int) -> None:
        """Nothing was heard, and nothing bridges it: what the wheel turned by meanwhile is not known."""
        self.missing_windows += windows
        self.spin_tracker.pause()
        self.drop_angle()

    def _compare(self, window: Window) -> None:
        """Forgets the angle when gravity lies elsewhere after a gap.

        Then the clock jumped, or the wheel did not turn as the straight line across the gap has it.
        """
        if window.spin_clipped > 0.0 or window.force_clipped > 0.0:
            # The carrier is not that of gravity, or gravity is cut off.
            self._looked, self._before = None, 0j
            return
        level = window.force * cmath.exp(1j * window.clock_angle)
        if self._looked is None or self._before == 0j:
            self._looked = None
            self._before = _OLD * self._before + _NEW * level
            return
        self._after, self._looked = self._after + level, self._looked + 1
        if self._looked < _LOOK:
            return
        turned = abs(cmath.phase(self._after * self._before.conjugate()))
        self._before, self._looked = self._after / _LOOK, None
        if turned > _LOST_ANGLE:
            self.angle_losses += 1
            self.drop_angle()

    def drop_angle(self) -> None:
        """The wheel angle is not known any more."""
        self.angle_initialised, self.alignment_count, self.gravity_sum, self.axial_sum = False, 0, 0j, 0.0
        self._before, self._looked = 0j, None
        self._heard = []

    def initialise_angle(self, x: list[float], p: Array, at_start: bool) -> list[int]:
        """Wheel angle from gravity: a force e^(-i theta) carried by e^(ic) points along e^(-i(theta - c)).

        at_begin: the angle where listening began, else where it ended. Returns the states that were begun
        anew; none where gravity was not found, and listening begins anew.
        """
        at, heard = self.columns, self._heard
        self._heard = []
        if any(window.spin_clipped > 0.0 for window in heard):
            spin = find_spin(heard, self.geometry.radius)
            if spin is None:
                self.drop_angle()
                return []
            angle = spin.start_angle if at_start else spin.end_angle
            level = self.alignment_count * STANDARD_GRAVITY * WINDOW_S
            x[at[RATE_BEYOND_RANGE]] = spin.excess if at_start else spin.excess_end
            self.spin_tracker.initialise(x[at[RATE_BEYOND_RANGE]], 0.0)
            self.steady_terms = spin.steady
            reset_state(p, at[RATE_BEYOND_RANGE], _FOUND_EXCESS**2)
            renewed = [at[WHEEL_ANGLE], at[RATE_BEYOND_RANGE]]
        else:
            angle, level = (
                -cmath.phase(self.gravity_sum)
                + (self.alignment_start_angle if at_start else self.alignment_end_angle),
                abs(self.gravity_sum),
            )
            renewed = [at[WHEEL_ANGLE]]
        x[at[WHEEL_ANGLE]] = math.remainder(angle, 2.0 * math.pi)
        # On a fast wheel a tilt lets far more into the axial accelerometer than a camber does.
        if x[at[CAMBER]] == 0.0 and self.steady_terms is None:
            x[at[CAMBER]] = self.geometry.side * math.atan2(self.axial_sum, level)
        reset_state(p, at[WHEEL_ANGLE], WHEEL_ANGLE.prior**2)
        self.angle_initialised = True
        return renewed


def reset_state(p: Array, place: int, variance: float) -> None:
    """Begins a state anew, in place, without memory."""
    p[place, :] = 0.0
    p[:, place] = 0.0
    p[place, place] = variance


@dataclass
class InitialState:
    """States and covariance before the first window.

    Besides, the variance by which each state wanders in a second, and where everything stands.
    """

    x: list[float]
    p: Array
    walk: Array
    columns: StateLayout
    wheels: list[Wheel] = field(default_factory=list)


def initial_state(config: WheelConfig) -> InitialState:
    """At rest at the origin, with the priors of all entries and what `config` knows better."""
    columns = StateLayout(len(config.nodes), config.position_aided, config.encoder_aided)
    made = InitialState(
        [0.0] * columns.size, np.zeros((columns.size, columns.size)), np.zeros(columns.size), columns
    )
    alone = len(config.nodes) == 1
    start = {HEADING: Quantity(config.start_heading, config.heading_sigma)}
    for entry in columns.vehicle:
        if alone and entry is TIME_OFFSET:
            continue
        _begin(made, columns.vehicle[entry], entry, {**config.priors, **start}.get(entry))
    for index, (name, node) in enumerate(config.nodes.items()):
        at = columns.wheels[index]
        side = side_sign(node.side)
        contact = 0.0 if node.steered else 0.5 * side * config.track_width
        geometry = WheelGeometry(side, config.radius, contact, float(index), config.ground_rate)
        view, follower = LinearisedWindow(geometry, at), SpinTracker(config.radius)
        wheel = Wheel(name, node, geometry, StandstillDetector(config.standstill_limits), at, view, follower)
        made.wheels.append(wheel)
        for entry in WHEEL_ENTRIES:
            _begin(made, at[entry], entry, node.priors.get(entry))
        made.walk[at[WHEEL_ANGLE]] = config.noise.gyro * config.noise.gyro
    return made


def _begin(made: InitialState, place: int, entry: Entry, known: Quantity | None) -> None:
    begin = known or Quantity(0.0, entry.prior)
    made.x[place] = begin.value
    made.p[place, place] = begin.sigma * begin.sigma
    # What forgets does not wander off: its noise is worked out with its memory.
    made.walk[place] = entry.random_walk * entry.random_walk if math.isinf(entry.correlation_time) else 0.0
