"""Drives with an erroneous odometer, a GNSS receiver and a compass, generated without the model under test.

The path is the integral of a smooth speed and yaw rate at 1 kHz (Simpson's rule, own code). Fixes get their
latitude and longitude by geodesics on the WGS 84 ellipsoid (Karney 2013), never by a map projection.
The odometer measures distance and turn per step with scale errors, a yaw rate that drifts with time and with
distance, and white noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyproj
from scipy.signal import oaconvolve

STEP = 1e-3
WGS84 = pyproj.Geod(ellps="WGS84")


@dataclass(frozen=True)
class Errors:
    """Errors of the odometer.

    scale, turn: relative errors of distance and turn. rate: yaw drift, rad/s; curve: yaw drift, rad/m. 1
    sigma of white noise: along, sideways: m per √m; heading: rad per √s.
    """

    scale: float = 0.0
    turn: float = 0.0
    rate: float = 0.0
    curve: float = 0.0
    along: float = 0.0
    sideways: float = 0.0
    heading: float = 0.0


def drawn(rng: np.random.Generator) -> Errors:
    """Draw the errors of a wheel node's odometry: 0.2 % radius, 0.5 % turn, 20 deg/h drift, road noise."""
    normal = rng.standard_normal
    return Errors(0.002 * normal(), 0.005 * normal(), 1e-4 * normal(), 2e-4 * normal(), 0.003, 0.003, 3e-4)


@dataclass(frozen=True)
class GnssDrive:
    """A drive with its odometry and its fixes.

    t, x, y, heading: truth at 1 kHz, metres east and north of (latitude_deg, longitude_deg). odo_*: poses of
    the odometer in its own frame, starting at 0, 0, 0. fix_*: fixes. length: path, m.
    """

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    heading: np.ndarray
    speed: np.ndarray
    odo_t: np.ndarray
    odo_x: np.ndarray
    odo_y: np.ndarray
    odo_heading: np.ndarray
    fix_t: np.ndarray
    fix_latitude_deg: np.ndarray
    fix_longitude_deg: np.ndarray
    origin: tuple[float, float]
    length: float

    def truth(self, t):
        """Return x, y and heading at times t."""
        return (np.interp(t, self.t, v) for v in (self.x, self.y, self.heading))


def loop(rng, length=250.0, speed=(0.8, 1.8), laps=1, standstill_s=5.0, wiggle=0.25):
    """Return speed, yaw rate at 1 kHz of `laps` laps of `length` metres in random legs, from rest to rest."""
    parts, done = [(standstill_s, 0.0, 0.0)], 0.0
    while done < laps * length:
        v = rng.uniform(*speed)
        duration = min(rng.uniform(3.0, 8.0), (laps * length - done) / v + 0.3)
        parts.append((duration, v, 2.0 * np.pi * v / length + rng.uniform(-wiggle, wiggle)))
        done += duration * v
    parts.append((3.0, 0.0, 0.0))
    counts = [int(part[0] / STEP) for part in parts]
    return tuple(_smooth(np.repeat([part[k] for part in parts], counts)) for k in (1, 2))


def drive(
    rng,
    motion,
    errors=None,
    rate_hz=10.0,
    fix_hz=5.0,
    sigma=5.0,
    origin=(47.37, 8.54),
    start_heading=None,
    antenna=(0.0, 0.0),
    delay=0.0,
):
    """Return the drive of a motion; delay: latency of the fixes relative to their time stamps, s."""
    speed, yaw = motion
    errors = errors or drawn(rng)
    t = np.arange(len(speed)) * STEP
    heading = (rng.uniform(-np.pi, np.pi) if start_heading is None else start_heading) + _integral(yaw)
    x, y = _integral(speed * np.cos(heading)), _integral(speed * np.sin(heading))
    fix_t = np.arange(t[0] + rng.uniform(0.0, 1.0 / fix_hz), t[-1], 1.0 / fix_hz)
    at = np.clip(fix_t + delay, t[0], t[-1])
    fx, fy, fh = (np.interp(at, t, v) for v in (x, y, heading))
    fx = fx + np.cos(fh) * antenna[0] - np.sin(fh) * antenna[1] + sigma * rng.standard_normal(len(at))
    fy = fy + np.sin(fh) * antenna[0] + np.cos(fh) * antenna[1] + sigma * rng.standard_normal(len(at))
    latitude, longitude = geodetic(fx, fy, *origin)
    every = round(1.0 / (rate_hz * STEP))
    odo = np.arange(0, len(t), every)
    odo_x, odo_y, odo_heading = _odometer(
        rng, t[odo], x[odo], y[odo], heading[odo], _integral(np.abs(speed))[odo], errors
    )
    return GnssDrive(
        t, x, y, heading, speed, t[odo], odo_x, odo_y, odo_heading,
        fix_t, latitude, longitude, origin, float(np.sum(np.abs(speed)) * STEP),
    )  # fmt: skip


def geodetic(east, north, latitude_deg, longitude_deg):
    """Return latitude and longitude, degrees, of points `east` and `north` metres from their origins.

    A point lies on the geodesic with that direction, at that distance. All arguments are scalars or (N,).
    """
    east, north, lat, lon = np.broadcast_arrays(east, north, latitude_deg, longitude_deg)
    azimuth, distance = np.degrees(np.arctan2(east, north)), np.hypot(east, north)
    longitude, latitude, _ = WGS84.fwd(lon, lat, azimuth, distance)
    return np.asarray(latitude), np.asarray(longitude)


def _odometer(rng, t, x, y, heading, distance, errors):
    dt, ds = np.diff(t), np.diff(distance)
    turn = np.diff(heading)
    middle = 0.5 * (heading[1:] + heading[:-1])
    chord = (np.diff(x) + 1j * np.diff(y)) * np.exp(-1j * middle)
    measured = turn * (1.0 + errors.turn) + errors.rate * dt + errors.curve * ds
    measured = measured + errors.heading * np.sqrt(dt) * rng.standard_normal(len(dt))
    noise = np.sqrt(np.abs(ds)) * (
        errors.along * rng.standard_normal(len(ds)) + 1j * errors.sideways * rng.standard_normal(len(ds))
    )
    chord = chord * (1.0 + errors.scale) + noise
    course = np.concatenate([[0.0], np.cumsum(measured)])
    place = np.concatenate([[0.0], np.cumsum(chord * np.exp(0.5j * (course[1:] + course[:-1])))])
    return place.real, place.imag, course


def _integral(value):
    """Integrate by Simpson's rule on pairs of steps, with the trapezoid between.

    Exact far below a micrometre for smooth motion.
    """
    trapezoid = 0.5 * STEP * (value[1:] + value[:-1])
    bend = np.zeros(len(value))
    bend[1:-1] = value[2:] - 2.0 * value[1:-1] + value[:-2]
    return np.concatenate([[0.0], np.cumsum(trapezoid - STEP / 24.0 * (bend[1:] + bend[:-1]))])


def _smooth(value, seconds=0.4):
    """Smooth by two passes of a raised cosine, by Fourier transform for speed."""
    width = int(seconds / STEP)
    kernel = np.hanning(2 * width + 3)
    kernel /= kernel.sum()
    for _ in range(2):
        value = oaconvolve(np.pad(value, width + 1, mode="edge"), kernel, mode="valid")
    return value
