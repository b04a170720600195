"""Start of a live graph: enough fixes for the heading, and a window with the factors of the batch."""

import numpy as np

from generators import gnss_drives
from graph_drives import wiggly_path
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.fixes import Fixes
from hubodo.fuse.graph.initialisation import start_graph

PATH = wiggly_path(np.random.default_rng(61))


def single_fixes(times, sigma=0.1):
    """Return one fix of the path at each time."""
    x, y = (np.interp(times, PATH.t, column) for column in (PATH.x, PATH.y))
    latitude, longitude = gnss_drives.geodetic(x, y, 47.0, 8.0)
    rows = zip(times, latitude, longitude, np.full(len(times), sigma), strict=True)
    return [Fixes(*(np.array([value]) for value in row)) for row in rows]


def test_two_fixes_do_not_start_a_graph_and_three_do():
    assert start_graph(PATH, single_fixes([2.0, 15.0]), GraphConfig(), 0.15) is None
    started = start_graph(PATH, single_fixes([2.0, 9.0, 15.0]), GraphConfig(), 0.15)
    assert started is not None and started.last_fix_t == 15.0
    assert started.window.pose_t[-1] == PATH.t[-1]


def test_fixes_that_cannot_determine_the_heading_do_not_start_a_graph():
    assert start_graph(PATH, single_fixes([2.0, 9.0, 15.0], sigma=50.0), GraphConfig(), 0.15) is None


def test_a_fix_that_is_not_newer_than_those_before_is_dropped():
    fixes = single_fixes([2.0, 9.0, 15.0])
    started = start_graph(PATH, [*fixes, fixes[0]], GraphConfig(), 0.15)
    assert started is not None and started.last_fix_t == 15.0
