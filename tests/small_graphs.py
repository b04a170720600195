"""Short drives as graphs, with every kind of factor in them."""

import numpy as np

from generators import gnss_drives
from hubodo.fuse.graph.build import build
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.heading import Headings
from hubodo.fuse.graph.fixes import Fixes, usable_fixes
from hubodo.fuse.graph.steps import OdometryPath


def wiggly_path(rng, n=200, dt=0.1):
    t = np.arange(n) * dt
    speed, yaw = 1.0 + 0.5 * np.sin(0.7 * t + rng.uniform(0, 6)), 0.6 * np.sin(0.5 * t + rng.uniform(0, 6))
    heading = np.cumsum(yaw) * dt
    return OdometryPath(
        t, np.cumsum(speed * np.cos(heading)) * dt, np.cumsum(speed * np.sin(heading)) * dt, heading
    )


def small_drive(rng, fixes=40, config=None):
    """A graph of a short drive with everything in it, and a first guess."""
    path = wiggly_path(rng)
    t = np.sort(rng.uniform(path.t[0], path.t[-1], fixes))
    e, n = (
        np.interp(t, path.t, path.x) + rng.normal(0, 1, fixes),
        np.interp(t, path.t, path.y) + rng.normal(0, 1, fixes),
    )
    config = config or GraphConfig(antenna=(0.4, -0.2))
    local = usable_fixes(Fixes(t, *gnss_drives.geodetic(e, n, 47.0, 8.0)), path.t[0], path.t[-1], 1.0, True)
    ht = np.arange(1.0, 18.0, 1.3)
    headings = Headings(ht, np.interp(ht, path.t, path.heading) + 0.05 * rng.standard_normal(len(ht)))
    return build(path, [local, headings], config)


def numeric(function, at, step=1e-6):
    """Central differences of a vector function by a vector, (rows, columns)."""
    columns = []
    for k in range(len(at)):
        up, down = at.copy(), at.copy()
        up[k] += step
        down[k] -= step
        columns.append((function(up) - function(down)) / (2.0 * step))
    return np.array(columns).T
