"""Drives for the graph: as the generator makes them, and as graphs of a few poses of all kinds of factors."""

from dataclasses import replace

import numpy as np

from generators import gnss_drives
from hubodo.fuse.graph.build import build_graph
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.heading import Headings
from hubodo.fuse.graph.fixes import Fixes, localise_fixes
from hubodo.fuse.track import Track


def wiggly_path(rng, n=200, dt=0.1):
    t = np.arange(n) * dt
    speed, yaw = 1.0 + 0.5 * np.sin(0.7 * t + rng.uniform(0, 6)), 0.6 * np.sin(0.5 * t + rng.uniform(0, 6))
    heading = np.cumsum(yaw) * dt
    return Track(t, np.cumsum(speed * np.cos(heading)) * dt, np.cumsum(speed * np.sin(heading)) * dt, heading)


def small_drive(rng, fixes=40, config=None):
    """A graph of a short drive with everything in it, and a first guess."""
    path = wiggly_path(rng)
    t = np.sort(rng.uniform(path.t[0], path.t[-1], fixes))
    e, n = (
        np.interp(t, path.t, path.x) + rng.normal(0, 1, fixes),
        np.interp(t, path.t, path.y) + rng.normal(0, 1, fixes),
    )
    config = config or GraphConfig(antenna=(0.4, -0.2))
    local = localise_fixes(Fixes(t, *gnss_drives.geodetic(e, n, 47.0, 8.0)), path.t[0], path.t[-1], 1.0, True)
    ht = np.arange(1.0, 18.0, 1.3)
    headings = Headings(ht, np.interp(ht, path.t, path.heading) + 0.05 * rng.standard_normal(len(ht)))
    return build_graph(path, [local, headings], config)


def numeric(function, at, step=1e-6):
    """Central differences of a vector function by a vector, (rows, columns)."""
    columns = []
    for k in range(len(at)):
        up, down = at.copy(), at.copy()
        up[k] += step
        down[k] -= step
        columns.append((function(up) - function(down)) / (2.0 * step))
    return np.array(columns).T


def make(seed, length=250.0, errors=None, motion=None, **kwargs):
    rng = np.random.default_rng([seed, 44])
    motion = gnss_drives.loop(rng, length=length) if motion is None else motion(rng)
    return gnss_drives.drive(rng, motion, errors or gnss_drives.drawn(rng), **kwargs)


def path_of(drive):
    return Track(drive.odo_t, drive.odo_x, drive.odo_y, drive.odo_heading)


def fixes_of(drive, keep=slice(None), sigma=None):
    selected = None if sigma is None else np.full(len(drive.fix_t), sigma)[keep]
    return Fixes(drive.fix_t[keep], drive.fix_latitude_deg[keep], drive.fix_longitude_deg[keep], selected)


def north(fixes, which, metres):
    target = gnss_drives.geodetic(0.0, np.where(which, metres, 0.0), fixes.latitude_deg, fixes.longitude_deg)
    return replace(fixes, latitude_deg=target[0])


def errors_of(drive, result):
    """(N, 3) of the track: east, north, heading."""
    zero = np.zeros(1)
    x, y = result.frame.to_local(*gnss_drives.geodetic(zero, zero, *drive.origin))
    tx, ty, th = drive.truth(result.track.t)
    turn = np.mod(result.track.heading - th + np.pi, 2 * np.pi) - np.pi
    return np.column_stack([result.track.x - x[0] - tx, result.track.y - y[0] - ty, turn])


def rms(error):
    return float(np.sqrt(np.mean(error[:, 0] ** 2 + error[:, 1] ** 2)))
