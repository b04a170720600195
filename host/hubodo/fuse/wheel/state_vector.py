"""State of the wheel filter: its initial value, its changes by type, and its covariance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from operator import add
from typing import ClassVar, NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import (
    GYRO_SCALE_ACROSS,
    GYRO_SCALE_COVARIANCE,
    GYRO_SCALE_Z,
    HEADING,
    TIME_OFFSET,
    WHEEL_ANGLE,
    WHEEL_ENTRIES,
    WHEEL_RADIUS,
    YAW_RATE_FROM_GRAVITY,
    Entry,
    StateLayout,
)
from hubodo.fuse.wheel.measurements import LinearisedWindow, Row, WheelGeometry, position
from hubodo.fuse.wheel.measurements.position import Position
from hubodo.fuse.wheel.motion_state import StandstillDetector
from hubodo.fuse.wheel.records import History, MeasurementTerms, StateChange, StateTransition
from hubodo.fuse.wheel.spin_search import SpinTracker
from hubodo.fuse.wheel.thresholds import GATE_SIGMA
from hubodo.fuse.wheel.wheel import Wheel
from hubodo.vehicle import side_sign


@dataclass(frozen=True, eq=False)
class Correction:
    """A Kalman update outside the update of a window: x + gain_root' innovation, p - gain_root' gain_root."""

    terms: MeasurementTerms
    is_replayable: ClassVar[bool] = False


class WindowCorrection(Correction):
    """A correction derived from the windows of a step, repeated by a replay."""

    is_replayable: ClassVar[bool] = True


class ExternalCorrection(Correction):
    """A correction from outside the windows: position, surface speed, track width."""


@dataclass(frozen=True, eq=False)
class Inflation:
    """Variances added to states for an error that the windows do not show; negative: removed again."""

    variances: Mapping[int, float]
    is_replayable: ClassVar[bool] = False


@dataclass(frozen=True, eq=False)
class StateReset:
    """States that their owner has reset in place: wheel angle, rate beyond range, or all after an outage.

    columns: states that carry no information about the past any more.
    """

    columns: Sequence[int]
    is_replayable: ClassVar[bool] = False


@dataclass
class InitialState:
    """States and covariance before the first window.

    Attributes
    ----------
    x, p : states, and their covariance (n, n).
    walk_variances : (n,), variance of the random walk of each state per second.
    columns : layout of the state.
    wheels : in the order of the nodes.
    """

    x: list[float]
    p: Array
    walk_variances: Array
    columns: StateLayout
    wheels: list[Wheel] = field(default_factory=list)


def initial_state(config: WheelConfig) -> InitialState:
    """Return the state at standstill at the origin, with the priors of all entries and of `config`."""
    layout = StateLayout(len(config.nodes), config.position_aided, config.encoder_aided)
    initial = InitialState(
        [0.0] * layout.size, np.zeros((layout.size, layout.size)), np.zeros(layout.size), layout
    )
    is_single = len(config.nodes) == 1
    start = {HEADING: Quantity(config.start_heading, config.heading_sigma)}
    for entry in layout.vehicle:
        if is_single and entry is TIME_OFFSET:
            continue
        _set_prior(initial, layout.vehicle[entry], entry, {**config.priors, **start}.get(entry))
    for index, (name, node) in enumerate(config.nodes.items()):
        columns = layout.wheels[index]
        side = side_sign(node.side)
        contact_y = 0.0 if node.steered else 0.5 * side * config.track_width
        geometry = WheelGeometry(side, config.radius, contact_y, float(index), config.ground_rate)
        view, tracker = LinearisedWindow(geometry, columns), SpinTracker(config.radius)
        detector = StandstillDetector(config.standstill_limits)
        initial.wheels.append(Wheel(name, node, geometry, detector, columns, view, tracker))
        for entry in WHEEL_ENTRIES:
            _set_prior(initial, columns[entry], entry, node.priors.get(entry))
        if GYRO_SCALE_ACROSS not in node.priors:
            _tie_gyro_scales(initial, columns)
        initial.walk_variances[columns[WHEEL_ANGLE]] = config.noise.gyro * config.noise.gyro
    _set_radius_priors(initial, config)
    # Both wheels measure the same unknown rotation of the ground, as a constant yaw rate.
    constant_rates = [columns[YAW_RATE_FROM_GRAVITY] for columns in layout.wheels]
    initial.p[np.ix_(constant_rates, constant_rates)] += config.ground_rate_sigma**2
    return initial


def _set_prior(initial: InitialState, column: int, entry: Entry, calibrated: Quantity | None) -> None:
    """Set value, variance and random walk of an entry."""
    prior = calibrated or Quantity(0.0, entry.prior)
    initial.x[column] = prior.value
    initial.p[column, column] = prior.sigma * prior.sigma
    # The noise of a Gauss-Markov process follows from its correlation time.
    initial.walk_variances[column] = (
        entry.random_walk * entry.random_walk if math.isinf(entry.correlation_time) else 0.0
    )


def _set_radius_priors(initial: InitialState, config: WheelConfig) -> None:
    """Set the priors of the radii that no calibration gives.

    The error that all wheels share is a state only if positions or another odometer measure it. Otherwise a
    wrong track width would be attributed to it, so it is no state and `common_scale_covariance` is added
    to the poses.
    """
    columns = [it.columns[WHEEL_RADIUS] for it in initial.wheels if WHEEL_RADIUS not in it.node.priors]
    initial.p[columns, columns] = config.radius_sigmas.own**2
    if config.position_aided or config.encoder_aided:
        initial.p[np.ix_(columns, columns)] += config.common_radius_sigma**2


def _tie_gyro_scales(initial: InitialState, columns: Mapping[Entry, int]) -> None:
    """Set the scale of the gyros across the axle to its prior given that of the gyro about the axle."""
    z, across = columns[GYRO_SCALE_Z], columns[GYRO_SCALE_ACROSS]
    variance = initial.p.item(z, z)
    gain = GYRO_SCALE_COVARIANCE / GYRO_SCALE_Z.prior**2
    initial.x[across] = gain * initial.x[z]
    initial.p[z, across] = initial.p[across, z] = gain * variance
    initial.p[across, across] = GYRO_SCALE_ACROSS.prior**2 - gain**2 * (GYRO_SCALE_Z.prior**2 - variance)


class Innovation(NamedTuple):
    """Innovation of a position.

    Attributes
    ----------
    z : (2,) m, measured minus expected position.
    s : (2, 2) m², its covariance.
    h : (2, n), derivatives of the expected position by the states.
    ph : (n, 2), covariance of the states with the expected position.
    nis : normalised innovation squared, z' s^-1 z.
    """

    z: Array
    s: Array
    h: Array
    ph: Array
    nis: float

    @property
    def cost(self) -> float:
        """Return -2 log likelihood, up to a constant."""
        return self.nis + float(np.linalg.slogdet(self.s)[1])


class StateVector:
    """States with their covariance, and the history of their steps.

    Attributes
    ----------
    x : list of the states, in the order of `columns`.
    p : their covariance (n, n).
    wheels : the wheels.
    history : records of the newest steps.
    changes : changes of the present step for smoothing; None if they are not recorded.
    """

    def __init__(self, initial: InitialState, history: History) -> None:
        self.x, self.p, self.wheels = initial.x, initial.p, initial.wheels
        self.columns, self._at = initial.columns, initial.columns.vehicle
        self.history = history
        self.changes: list[StateChange] | None = None

    def record_change(self, change: StateChange) -> None:
        """Record a change of the states for smoothing."""
        if self.changes is not None:
            self.changes.append(change)

    def record_reset(self, columns: Sequence[int]) -> None:
        """Record that states were reset, so that they carry no information about the past."""
        if columns:
            self.record_change(StateTransition(columns))

    def estimate(self, node: str | None, entry: Entry) -> Quantity:
        """Return value and 1 sigma of an entry.

        node: None for an entry of the vehicle, else the node's name; the sign is that of a node facing left.
        """
        columns = self._at if node is None else next(it.columns for it in self.wheels if it.name == node)
        column = columns[entry]
        return Quantity(self.x[column], math.sqrt(max(0.0, self.p[column, column])))

    def mean_sigma(self, entry: Entry) -> float:
        """Return the 1 sigma of the mean of an entry over the wheels."""
        columns = [wheel.columns[entry] for wheel in self.wheels]
        return math.sqrt(max(0.0, float(self.p[np.ix_(columns, columns)].mean())))

    def apply(self, change: Correction | Inflation | StateReset) -> None:
        """Apply a correction, or register a reset; set a barrier if a replay would not reproduce it."""
        if isinstance(change, StateReset):
            self.record_reset(change.columns)
        elif isinstance(change, Inflation):
            for column, variance in change.variances.items():
                self.p[column, column] += variance
        else:
            innovation, _, gain_root = change.terms
            self.x = list(map(add, self.x, innovation.dot(gain_root).tolist()))
            self.p -= gain_root.T.dot(gain_root)
            self.record_change(change.terms)
        if not change.is_replayable:
            self.history.set_barrier()

    def position_innovation(self, measured: Position) -> Innovation:
        """Return the innovation of a position at the end of the last window."""
        rows = position.measure(self.x, self._at, measured)
        z = np.array([row[0] for row in rows])
        h = np.array([self.derivatives(row, self._at) for row in rows])
        ph = self.p @ h.T
        s = h @ ph + np.diag([row[1] for row in rows])
        return Innovation(z, s, h, ph, float(z @ np.linalg.solve(s, z)))

    def update_with_position(self, innovation: Innovation) -> None:
        """Update the state with a position."""
        whitening = np.linalg.inv(np.linalg.cholesky(innovation.s))
        self.apply(
            ExternalCorrection(
                MeasurementTerms(
                    whitening @ innovation.z, whitening @ innovation.h, whitening @ innovation.ph.T
                )
            )
        )

    def derivatives(self, row: Row, columns: Mapping[Entry, int]) -> Array:
        """Return a row of the Jacobian, (n,), from its nonzero derivatives."""
        h = np.zeros(len(self.x))
        for entry, value in row[2].items():
            h[columns[entry]] = value
        return h

    def update_with_row(
        self, row: Row, columns: Mapping[Entry, int], kind: type[Correction] = WindowCorrection
    ) -> None:
        """Update the state with a single row; an outlier is down-weighted to the gate."""
        residual, variance, _ = row
        h = self.derivatives(row, columns)
        ph = self.p @ h
        s = max(float(h @ ph) + variance, residual**2 / GATE_SIGMA**2)
        self.apply(kind(MeasurementTerms.of_row(residual, h, ph, s)))

    def inflate(self, variances: Mapping[Entry, float]) -> None:
        """Add variances to entries of the vehicle for an error that the windows do not show."""
        self.apply(Inflation({self._at[entry]: variance for entry, variance in variances.items()}))
