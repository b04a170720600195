"""Drives for tests of the graph: drives of the generator, and small graphs with every kind of factor."""

from dataclasses import replace

import numpy as np

from generators import gnss_drives
from hubodo.fuse.graph.build import build_graph
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.heading import Headings
from hubodo.fuse.graph.fixes import Fixes, localise_fixes
from hubodo.fuse.track import Track


def wiggly_path(rng, n=200, dt=0.1):
    """Return an odometry track of `n` poses with changing speed and yaw rate."""
    t = np.arange(n) * dt
    speed, yaw = 1.0 + 0.5 * np.sin(0.7 * t + rng.uniform(0, 6)), 0.6 * np.sin(0.5 * t + rng.uniform(0, 6))
    heading = np.cumsum(yaw) * dt
    return Track(t, np.cumsum(speed * np.cos(heading)) * dt, np.cumsum(speed * np.sin(heading)) * dt, heading)


def small_drive_graph(rng, n_fixes=40, config=None):
    """Return the graph of a short drive with every kind of factor, and its initial guess."""
    path = wiggly_path(rng)
    t = np.sort(rng.uniform(path.t[0], path.t[-1], n_fixes))
    east, north = (
        np.interp(t, path.t, path.x) + rng.normal(0, 1, n_fixes),
        np.interp(t, path.t, path.y) + rng.normal(0, 1, n_fixes),
    )
    config = config or GraphConfig(antenna=(0.4, -0.2))
    local_fixes = localise_fixes(
        Fixes(t, *gnss_drives.geodetic(east, north, 47.0, 8.0)), path.t[0], path.t[-1], 1.0, True
    )
    heading_t = np.arange(1.0, 18.0, 1.3)
    headings = Headings(
        heading_t, np.interp(heading_t, path.t, path.heading) + 0.05 * rng.standard_normal(len(heading_t))
    )
    return build_graph(path, [local_fixes, headings], config)


def central_differences(function, point, step=1e-6):
    """Return the derivative of a vector function of a vector by central differences, (rows, columns)."""
    columns = []
    for k in range(len(point)):
        above, below = point.copy(), point.copy()
        above[k] += step
        below[k] -= step
        columns.append((function(above) - function(below)) / (2.0 * step))
    return np.array(columns).T


def simulate_drive(seed, length=250.0, errors=None, motion=None, **kwargs):
    """Return a drive of the generator, by default a loop with random odometry errors."""
    rng = np.random.default_rng([seed, 44])
    motion = gnss_drives.loop(rng, length=length) if motion is None else motion(rng)
    return gnss_drives.drive(rng, motion, errors or gnss_drives.drawn(rng), **kwargs)


def odometry_path(drive):
    """Return the odometry of a drive as a track."""
    return Track(drive.odo_t, drive.odo_x, drive.odo_y, drive.odo_heading)


def drive_fixes(drive, keep=slice(None), sigma=None):
    """Return the selected fixes of a drive, with a common declared sigma, m, if one is given."""
    sigmas = None if sigma is None else np.full(len(drive.fix_t), sigma)[keep]
    return Fixes(drive.fix_t[keep], drive.fix_latitude_deg[keep], drive.fix_longitude_deg[keep], sigmas)


def shift_north(fixes, which, metres):
    """Return fixes of which those in the mask `which` are moved north, m."""
    target = gnss_drives.geodetic(0.0, np.where(which, metres, 0.0), fixes.latitude_deg, fixes.longitude_deg)
    return replace(fixes, latitude_deg=target[0])


def track_errors(drive, result):
    """Return the errors of a fused track, (N, 3): east, north, heading."""
    origin = np.zeros(1)
    x, y = result.frame.to_local(*gnss_drives.geodetic(origin, origin, *drive.origin))
    tx, ty, th = drive.truth(result.track.t)
    heading_error = np.mod(result.track.heading - th + np.pi, 2 * np.pi) - np.pi
    return np.column_stack([result.track.x - x[0] - tx, result.track.y - y[0] - ty, heading_error])


def position_rms(error):
    """Return the rms of the position error, m."""
    return float(np.sqrt(np.mean(error[:, 0] ** 2 + error[:, 1] ** 2)))
