"""Initial states and covariance of the wheel filter."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import HEADING, TIME_OFFSET, WHEEL_ANGLE, WHEEL_ENTRIES, Entry, StateLayout
from hubodo.fuse.wheel.measurements import LinearisedWindow, WheelGeometry
from hubodo.fuse.wheel.motion_state import StandstillDetector
from hubodo.fuse.wheel.spin_search import SpinTracker
from hubodo.fuse.wheel.wheel import Wheel
from hubodo.vehicle import side_sign


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
        initial.walk_variances[columns[WHEEL_ANGLE]] = config.noise.gyro * config.noise.gyro
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
