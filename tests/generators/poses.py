"""An IMU carried by hand from pose to pose, from first principles: scipy's attitudes, rates in closed form.

It shares nothing with the calibration under test. Between poses the node turns about one axis fixed in it, by
an angle that follows a raised cosine, so its rate is known exactly at every instant; sensor errors are
written out term by term after eq. 1 and 2 of Avrutov.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

GRAVITY = 9.81
EARTH = 7.2921159e-5


@dataclass(frozen=True)
class Errors:
    """Bias b, scale error e and the six misalignment angles xz, xy, yz, yx, zy, zx of one triad."""

    b: tuple = (0.0, 0.0, 0.0)
    e: tuple = (0.0, 0.0, 0.0)
    d: dict = field(default_factory=dict)

    def measure(self, true):
        x, y, z = true.T
        d = {name: self.d.get(name, 0.0) for name in ("xz", "xy", "yz", "yx", "zy", "zx")}
        return np.column_stack(
            [
                self.b[0] + (1 + self.e[0]) * x + d["xz"] * y - d["xy"] * z,
                self.b[1] + (1 + self.e[1]) * y - d["yz"] * x + d["yx"] * z,
                self.b[2] + (1 + self.e[2]) * z + d["zy"] * x - d["zx"] * y,
            ]
        )


@dataclass(frozen=True)
class Carried:
    t: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    true_rate: np.ndarray
    true_force: np.ndarray


def carry(
    rng,
    gyro,
    accel,
    *,
    poses=24,
    standstill_s=6.0,
    turn=2.5,
    dt=0.01,
    gyro_noise=0.004,
    accel_noise=0.01,
    latitude=None,
    attitudes=None,
    g_sensitivity=None,
):
    """Return a record with standstills in random attitudes and turns of `turn` s between them.

    attitudes: scipy Rotations from node to world instead of random ones. latitude: rad; adds Earth rate.
    g_sensitivity: (3, 3) (rad/s)/(m/s²).
    """
    if attitudes is None:
        attitudes = Rotation.random(poses, rng=rng)
    rates, forces = [], []
    up, earth = np.array([0.0, 0.0, GRAVITY]), np.zeros(3)
    if latitude is not None:
        earth = EARTH * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    for k in range(len(attitudes)):
        still = round(standstill_s / dt)
        node = attitudes[k]
        rates.append(np.tile(node.inv().apply(earth), (still, 1)))
        forces.append(np.tile(node.inv().apply(up), (still, 1)))
        if k + 1 < len(attitudes):
            step = (node.inv() * attitudes[k + 1]).as_rotvec()
            s = np.arange(round(turn / dt)) * dt / turn
            share = s - np.sin(2 * np.pi * s) / (2 * np.pi)
            speed = (1 - np.cos(2 * np.pi * s)) / turn
            now = node * Rotation.from_rotvec(share[:, None] * step)
            rates.append(speed[:, None] * step + now.inv().apply(earth))
            forces.append(now.inv().apply(up))
    rate, force = np.concatenate(rates), np.concatenate(forces)
    t = np.arange(len(rate)) * dt
    shown = gyro.measure(rate)
    if g_sensitivity is not None:
        shown = shown + force @ np.asarray(g_sensitivity).T
    return Carried(
        t,
        shown + gyro_noise * rng.standard_normal(rate.shape),
        accel.measure(force) + accel_noise * rng.standard_normal(rate.shape),
        rate,
        force,
    )


def laid_on_faces(rng, off_deg, times=1):
    """Return attitudes of a box on its six faces, with errors of `off_deg` degrees (1 sigma) per axis."""
    flat = Rotation.from_euler(
        "xyz", [[0, 0, 0], [180, 0, 0], [90, 0, 0], [-90, 0, 0], [0, 90, 0], [0, -90, 0]], True
    )
    faces = Rotation.concatenate([flat] * times)
    return faces * Rotation.from_rotvec(np.radians(off_deg) * rng.standard_normal((len(faces), 3)))
