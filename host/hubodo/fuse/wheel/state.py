"""Where the wheel filter starts: its states, what is known of them, and the book kept for each wheel."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, field, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.clipping import SpinFollower, find_spin
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import (
    CAMBER,
    EXCESS,
    HEADING,
    OF_WHEEL,
    TIME_OFFSET,
    WHEEL_ANGLE,
    Columns,
    Entry,
)
from hubodo.fuse.wheel.grip import Grip
from hubodo.fuse.wheel.measurements import WheelGeometry, WheelWindow
from hubodo.fuse.wheel.measurements.steady import Steady
from hubodo.fuse.wheel.stillness import RestDetector
from hubodo.fuse.wheel.window import NOTHING, WINDOW, Window
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

UNHEARD = 0.5
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
    rest: RestDetector
    at: dict[Entry, int]
    view: WheelWindow
    follower: SpinFollower
    grip: Grip = field(default_factory=Grip)
    joined: bool = False
    away: bool = False
    trusted: bool = True
    astray: int = 0
    steady: Steady | None = None
    arm_known: tuple[float, float] | None = None
    part: bool = True
    heard: int = 0
    level: complex = 0j
    axial: float = 0.0
    begin: float = 0.0
    spin: float = 0.0
    turned: float = 0.0
    forwards: float = 0.0
    upright: float = 0.0
    moving: int = 0
    slips: int = 0
    clipped: int = 0
    unheard_in_all: int = 0
    lost: int = 0
    _heard: list[Window] = field(default_factory=list)
    _before: complex = 0j
    _after: complex = 0j
    _looked: int | None = None

    def move_over(self) -> None:
        """To the other side of the vehicle."""
        seen = self.geometry
        self.geometry = replace(seen, contact=-seen.contact)
        self.view = WheelWindow(self.geometry, self.at)

    def rolls(self, window: Window) -> bool:
        """Whether the window tells the speed of the vehicle."""
        return self.joined and self.trusted and not self.away and window.missing < UNHEARD

    def watch(self, window: Window, rate: float, angle: float) -> None:
        """Counts for the report; rate: rad/s at which it turns, angle: at the beginning of the window."""
        self.turned += abs(rate) * WINDOW
        self.forwards += rate * WINDOW
        self.clipped += window.spin_clipped > 0.0
        if self.moving < _ENOUGH and abs(rate) > _TURNING and self.joined and window.force_clipped == 0.0:
            middle = cmath.exp(1j * (angle + 0.5 * rate * WINDOW))
            self.upright += (window.force * middle).real / (STANDARD_GRAVITY * WINDOW)
            self.moving += 1

    def listen(self, window: Window) -> None:
        """Gathers gravity, carried along with the spin, until the wheel angle can be read from it."""
        if window is NOTHING:
            self.unhear(1)
            return
        if window.missing > 0.5:
            self.unheard_in_all += 1
            self._after, self._looked = 0j, 0
            return
        if self.joined:
            self._compare(window)
            return
        if self.heard == 0:
            self.begin = window.clock_angle - 0.5 * window.spin
        self.heard += 1
        self._heard.append(window)
        self.level += window.force * cmath.exp(1j * window.clock_angle)
        self.axial += window.axial
        self.spin = window.clock_angle + 0.5 * window.spin

    def unhear(self, windows: int) -> None:
        """Nothing was heard, and nothing bridges it: what the wheel turned by meanwhile is not known."""
        self.unheard_in_all += windows
        self.follower.rest()
        self.forget()

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
            self.lost += 1
            self.forget()

    def forget(self) -> None:
        """The wheel angle is not known any more."""
        self.joined, self.heard, self.level, self.axial = False, 0, 0j, 0.0
        self._before, self._looked = 0j, None
        self._heard = []

    def join(self, x: list[float], p: Array, at_begin: bool) -> list[int]:
        """Wheel angle from gravity: a force e^(-i theta) carried by e^(ic) points along e^(-i(theta - c)).

        at_begin: the angle where listening began, else where it ended. Returns the states that were begun
        anew; none where gravity was not found, and listening begins anew.
        """
        at, heard = self.at, self._heard
        self._heard = []
        if any(window.spin_clipped > 0.0 for window in heard):
            spin = find_spin(heard, self.geometry.radius)
            if spin is None:
                self.forget()
                return []
            angle = spin.begin if at_begin else spin.end
            level = self.heard * STANDARD_GRAVITY * WINDOW
            x[at[EXCESS]] = spin.excess if at_begin else spin.excess_end
            self.follower.begin(x[at[EXCESS]], 0.0)
            self.steady = spin.steady
            renew(p, at[EXCESS], _FOUND_EXCESS**2)
            renewed = [at[WHEEL_ANGLE], at[EXCESS]]
        else:
            angle, level = -cmath.phase(self.level) + (self.begin if at_begin else self.spin), abs(self.level)
            renewed = [at[WHEEL_ANGLE]]
        x[at[WHEEL_ANGLE]] = math.remainder(angle, 2.0 * math.pi)
        # On a fast wheel a tilt lets far more into the axial accelerometer than a camber does.
        if x[at[CAMBER]] == 0.0 and self.steady is None:
            x[at[CAMBER]] = self.geometry.side * math.atan2(self.axial, level)
        renew(p, at[WHEEL_ANGLE], WHEEL_ANGLE.prior**2)
        self.joined = True
        return renewed


def renew(p: Array, place: int, variance: float) -> None:
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
    columns: Columns
    wheels: list[Wheel] = field(default_factory=list)


def initial_state(config: WheelConfig) -> InitialState:
    """At rest at the origin, with the priors of all entries and what `config` knows better."""
    columns = Columns(len(config.nodes), config.told, config.encoder)
    made = InitialState(
        [0.0] * columns.size, np.zeros((columns.size, columns.size)), np.zeros(columns.size), columns
    )
    alone = len(config.nodes) == 1
    start = {HEADING: Quantity(config.start_heading, config.heading_sigma)}
    for entry in columns.vehicle:
        if alone and entry is TIME_OFFSET:
            continue
        _begin(made, columns.vehicle[entry], entry, {**config.known, **start}.get(entry))
    for index, (name, node) in enumerate(config.nodes.items()):
        at = columns.wheels[index]
        side = side_sign(node.side)
        contact = 0.0 if node.steered else 0.5 * side * config.track_width
        geometry = WheelGeometry(side, config.radius, contact, float(index), config.ground_rate)
        view, follower = WheelWindow(geometry, at), SpinFollower(config.radius)
        wheel = Wheel(name, node, geometry, RestDetector(config.rest), at, view, follower)
        made.wheels.append(wheel)
        for entry in OF_WHEEL:
            _begin(made, at[entry], entry, node.known.get(entry))
        made.walk[at[WHEEL_ANGLE]] = config.noise.gyro * config.noise.gyro
    return made


def _begin(made: InitialState, place: int, entry: Entry, known: Quantity | None) -> None:
    begin = known or Quantity(0.0, entry.prior)
    made.x[place] = begin.value
    made.p[place, place] = begin.sigma * begin.sigma
    # What forgets does not wander off: its noise is worked out with its memory.
    made.walk[place] = entry.walk * entry.walk if math.isinf(entry.forgets) else 0.0
