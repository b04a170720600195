"""What the graph gives at the odometry's times: signed speeds, and a first guess that lies on the fixes."""

import numpy as np
import pytest

from generators import gnss_drives
from graph_drives import wiggly_path
from hubodo.fuse.graph.build import build
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.fixes import Fixes, usable_fixes
from hubodo.fuse.graph.graph import fuse_graph
from hubodo.fuse.graph.steps import OdometryPath


@pytest.mark.parametrize("speed", [1.2, -0.4])
def test_a_vehicle_that_reverses_has_a_negative_speed_wherever_it_looks(speed):
    """0.1 s at a time on a circle to the left, from a heading of 2 rad."""
    t = np.arange(0.0, 8.0, 0.1)
    heading = 2.0 + 0.5 * t
    x, y = (speed / 0.5 * part for part in (np.sin(heading) - np.sin(2.0), np.cos(2.0) - np.cos(heading)))
    track = fuse_graph(OdometryPath(t, x, y, heading), None).track
    # A chord of 0.05 rad is 1e-4 shorter than its arc.
    assert track.speed == pytest.approx(np.full(len(t), speed), rel=2e-4)


@pytest.mark.parametrize("turn", [0.0, 1.3, -2.8])
def test_the_first_guess_lies_on_the_fixes_however_far_off_and_turned_the_odometry_is(turn):
    path = wiggly_path(np.random.default_rng(3))
    way = (path.x + 1j * path.y) * np.exp(1j * turn)
    at = slice(0, None, 5)
    there = gnss_drives.geodetic(way.real[at], way.imag[at], 47.0, 8.0)
    local = usable_fixes(Fixes(path.t[at], *there), path.t[0], path.t[-1], 0.1, True)
    off = OdometryPath(path.t, path.x + 300.0, path.y - 200.0, path.heading)
    drive = build(off, [local], GraphConfig())
    use = np.searchsorted(drive.cut.state_t, local.t)
    assert drive.poses[use, 0] == pytest.approx(local.place.real, abs=0.1)
    assert drive.poses[use, 1] == pytest.approx(local.place.imag, abs=0.1)
    apart = drive.poses[use, 2] - path.heading[at] - turn
    assert np.abs(np.angle(np.exp(1j * apart))).max() < 0.02
