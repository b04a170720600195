"""Differential odometry from the spin of two wheels, with a covariance that includes constant errors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from hubodo.fuse.rolling_wheel import OdometryNoise, RollingWheel, WheelSamples, WheelSpec
from hubodo.time_gaps import check_time_gaps
from hubodo.vehicle import Side

_BATCH_NS = 1_000_000_000
"""ns of samples of each wheel that are processed in turn."""
_MAX_PAUSE = 20_000.0
"""s; poses go on at the same rate over a pause, and for a longer one they would not fit into memory."""


@dataclass(frozen=True, slots=True)
class OdometryConfig:
    """Settings of the differential odometry.

    Attributes
    ----------
    left, right : the wheels and their nodes.
    track_width : m, between the contact points.
    step_ns : ns between poses.
    estimate_bias : whether a gyro's bias is estimated while its wheel is stationary.
    noise : sigmas of the covariance.
    """

    left: WheelSpec
    right: WheelSpec
    track_width: float
    step_ns: int = 10_000_000
    estimate_bias: bool = True
    noise: OdometryNoise = field(default_factory=OdometryNoise)


@dataclass(frozen=True, slots=True)
class OdometryState:
    """Pose and motion of the body at one time.

    Attributes
    ----------
    t_ns : ns on the host's clock.
    x, y : m, in the frame of the start.
    heading : rad, anticlockwise.
    speed, yaw_rate : m/s and rad/s, means over the step.
    distance : m rolled; rolling backwards counts too.
    covariance : 3 x 3 of x, y, heading, in the frame of the start.
    twist_covariance : 2 x 2 of speed and yaw_rate.
    """

    t_ns: int
    x: float
    y: float
    heading: float
    speed: float
    yaw_rate: float
    distance: float
    covariance: tuple[tuple[float, float, float], ...]
    twist_covariance: tuple[tuple[float, float], ...]


class SampleOutcome(Enum):
    """Outcome of adding samples."""

    ADVANCED = "new poses"
    WAITING = "buffered until samples of the other wheel come"
    LATE = "some were not newer than earlier ones, and were dropped"


@dataclass(frozen=True, slots=True)
class OdometryOutput:
    """The outcome of adding samples, and the states that they completed, oldest first."""

    outcome: SampleOutcome
    states: tuple[OdometryState, ...]


class DifferentialOdometry:
    """Differential odometry, Shah et al. eq. 16: ds = (dsl + dsr) / 2, dtheta = (dsr - dsl) / b.

    dsl and dsr are the distances rolled by the left and the right wheel in a step, b the track width; the
    step ds points along the heading in the middle of the step. Each wheel's speed is its radius times the
    rate about its axle, with the signs of the model's README; distances are integrated by the trapezoid rule
    at the samples' own times and interpolated at common times every `step_ns`. Across missing samples the
    speed is interpolated linearly, at the cost of a variance of q dt^3 / 12 (integral of a Brownian bridge, q
    the power density of the speed's random walk). Errors that are constant over a drive (radii, track, gyro
    biases) enter through the derivatives of the pose with respect to them, not as noise.
    """

    def __init__(self, config: OdometryConfig) -> None:
        self._config = config
        noise = config.noise
        self._wheels: dict[Side, RollingWheel] = {
            "left": RollingWheel(config.left, noise, config.estimate_bias),
            "right": RollingWheel(config.right, noise, config.estimate_bias),
        }
        self._t_ns: int | None = None
        self._last_distances: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
        self._x = self._y = self._heading = self._distance = 0.0
        self._covariance = [[0.0] * 3 for _ in range(3)]
        # Derivatives of the pose by the errors of: both radii, left radius, right radius, track width, left
        # bias, right bias.
        self._jacobian = [[0.0] * 6 for _ in range(3)]
        self._bias_sigmas = [config.left.gyro_bias_sigma, config.right.gyro_bias_sigma]
        self._state: OdometryState | None = None

    def add_samples(self, samples: WheelSamples) -> OdometryOutput:
        """Add samples of one wheel; wheels may come in any order and batch size."""
        wheel = self._wheels[samples.side]
        late = wheel.add_samples(samples)
        states = tuple(self._advance())
        if late:
            return OdometryOutput(SampleOutcome.LATE, states)
        return OdometryOutput(SampleOutcome.ADVANCED if states else SampleOutcome.WAITING, states)

    def state(self) -> OdometryState | None:
        """Return the newest pose, None before both wheels have samples of a common time."""
        return self._state

    def biases(self) -> dict[Side, tuple[float, float]]:
        """Return the gyro bias in use and its 1 sigma by wheel, rad/s."""
        return {side: (wheel.bias, wheel.bias_sigma) for side, wheel in self._wheels.items()}

    def finish(self) -> tuple[OdometryState, ...]:
        """Process the samples that still wait for a first bias estimate; called after the last sample."""
        for wheel in self._wheels.values():
            wheel.is_initialised = True
        return tuple(self._advance())

    def _advance(self) -> list[OdometryState]:
        left, right = self._wheels["left"], self._wheels["right"]
        if not (left.is_initialised and right.is_initialised and left.knots and right.knots):
            return []
        step = self._config.step_ns
        if self._t_ns is None:
            start = max(left.knots[0][0], right.knots[0][0])
            start = -(-start // step) * step
            if start > min(left.newest_t_ns, right.newest_t_ns):
                return []
            self._t_ns = start
            self._last_distances = (left.distance_at(start), right.distance_at(start))
            self._state = self._make_state(start, 0.0, 0.0, 0.0, 0.0)
            states = [self._state]
        else:
            states = []
        end = min(left.newest_t_ns, right.newest_t_ns)
        while self._t_ns + step <= end:
            self._t_ns += step
            states.append(
                self._integrate_step(self._t_ns, left.distance_at(self._t_ns), right.distance_at(self._t_ns))
            )
        return states

    def _integrate_step(
        self, t_ns: int, left: tuple[float, float], right: tuple[float, float]
    ) -> OdometryState:
        (before_l, before_r), self._last_distances = self._last_distances, (left, right)
        dl, dr = left[0] - before_l[0], right[0] - before_r[0]
        vl, vr = left[1] - before_l[1], right[1] - before_r[1]
        b, dt = self._config.track_width, self._config.step_ns * 1e-9
        ds, dtheta = 0.5 * (dl + dr), (dr - dl) / b
        mid = self._heading + 0.5 * dtheta
        cos, sin = math.cos(mid), math.sin(mid)
        self._x += ds * cos
        self._y += ds * sin
        self._heading += dtheta
        self._distance += abs(ds)
        self._propagate_covariance(ds, cos, sin, vl, vr)
        rl, rr = self._config.left.radius * dt, self._config.right.radius * dt
        self._absorb_old_bias_errors()
        per_parameter = (
            (ds, dtheta),
            (0.5 * dl, -dl / b),
            (0.5 * dr, dr / b),
            (0.0, -dtheta),
            (0.5 * rl, -rl / b),
            (0.5 * rr, rr / b),
        )
        jx, jy, jh = self._jacobian
        for k, (d, turn) in enumerate(per_parameter):
            h = jh[k] + 0.5 * turn
            jx[k] += cos * d - ds * sin * h
            jy[k] += sin * d + ds * cos * h
            jh[k] += turn
        self._state = self._make_state(t_ns, ds / dt, dtheta / dt, vl / dt**2, vr / dt**2)
        return self._state

    def _propagate_covariance(self, ds: float, cos: float, sin: float, vl: float, vr: float) -> None:
        """Propagate P = F P F' + Q over one step.

        Q is set up in the body's axes and rotated by the heading halfway through the step.
        """
        b, p = self._config.track_width, self._covariance
        a, c = -ds * sin, ds * cos
        xx = p[0][0] + 2 * a * p[0][2] + a * a * p[2][2]
        xy = p[0][1] + a * p[1][2] + c * p[0][2] + a * c * p[2][2]
        yy = p[1][1] + 2 * c * p[1][2] + c * c * p[2][2]
        xh, yh, hh = p[0][2] + a * p[2][2], p[1][2] + c * p[2][2], p[2][2]
        qh = (vl + vr) / b**2
        forward = 0.25 * (vl + vr)
        side = self._config.noise.lateral**2 * abs(ds) + 0.25 * ds * ds * qh
        fh, sh = 0.5 * (vr - vl) / b, 0.5 * ds * qh
        fs = 0.5 * ds * fh
        xx += cos * cos * forward - 2 * cos * sin * fs + sin * sin * side
        yy += sin * sin * forward + 2 * cos * sin * fs + cos * cos * side
        xy += cos * sin * (forward - side) + (cos * cos - sin * sin) * fs
        xh += cos * fh - sin * sh
        yh += sin * fh + cos * sh
        hh += qh
        self._covariance = [[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]]

    def _absorb_old_bias_errors(self) -> None:
        """Add the effect of the old bias error to the covariance where a bias has been re-estimated.

        The error of the new estimate is a different random variable, so its Jacobian starts from zero.
        """
        for k, side in ((4, "left"), (5, "right")):
            wheel = self._wheels["left" if side == "left" else "right"]
            if wheel.bias_sigma == self._bias_sigmas[k - 4]:
                continue
            variance = self._bias_sigmas[k - 4] ** 2
            for i in range(3):
                for j in range(3):
                    self._covariance[i][j] += self._jacobian[i][k] * self._jacobian[j][k] * variance
            for i in range(3):
                self._jacobian[i][k] = 0.0
            self._bias_sigmas[k - 4] = wheel.bias_sigma

    def _make_state(self, t_ns: int, speed: float, yaw_rate: float, vl: float, vr: float) -> OdometryState:
        noise, b = self._config.noise, self._config.track_width
        each = noise.radius_each**2
        both, track = noise.radius**2, noise.track**2
        left, right = (s * s for s in self._bias_sigmas)

        def total(i: int, k: int) -> float:
            u, v = self._jacobian[i], self._jacobian[k]
            wheels = u[0] * v[0] * both + u[1] * v[1] * each + u[2] * v[2] * each + u[3] * v[3] * track
            return self._covariance[i][k] + (wheels + u[4] * v[4] * left + u[5] * v[5] * right)

        xx, xy, xh, yy, yh, hh = (total(i, k) for i, k in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
        cross = 0.5 * (vr - vl) / b
        return OdometryState(
            t_ns,
            self._x,
            self._y,
            self._heading,
            speed,
            yaw_rate,
            self._distance,
            ((xx, xy, xh), (xy, yy, yh), (xh, yh, hh)),
            ((0.25 * (vl + vr), cross), (cross, (vl + vr) / b**2)),
        )


def integrate_wheels(config: OdometryConfig, wheels: Sequence[WheelSamples]) -> list[OdometryState]:
    """Return all poses of recorded wheels, bit-identical to those of a live run.

    Raises InputError for time stamps that cannot belong to one recording.
    """
    for wheel in wheels:
        check_time_gaps(np.asarray(wheel.t_ns, np.float64) * 1e-9, f"{wheel.side} wheel", _MAX_PAUSE)
    odometry = DifferentialOdometry(config)
    states: list[OdometryState] = []
    for batch in _split_by_second(wheels):
        states += odometry.add_samples(batch).states
    return [*states, *odometry.finish()]


def _split_by_second(wheels: Sequence[WheelSamples]) -> Iterator[WheelSamples]:
    """Yield batches of the wheels in turn, so that no wheel gets far ahead of the other."""
    starts = [int(wheel.t_ns[0]) for wheel in wheels if len(wheel.t_ns)]
    ends = [int(wheel.t_ns[-1]) for wheel in wheels if len(wheel.t_ns)]
    if not starts:
        return
    edges = np.arange(min(starts), max(ends) + 2 * _BATCH_NS, _BATCH_NS, dtype=np.int64)
    indices = [np.searchsorted(wheel.t_ns, edges) for wheel in wheels]
    for k in range(len(edges) - 1):
        for wheel, index in zip(wheels, indices, strict=True):
            rows = slice(index[k], index[k + 1])
            if rows.stop > rows.start:
                yield WheelSamples(wheel.side, wheel.t_ns[rows], wheel.gyro[rows], wheel.accel[rows])
