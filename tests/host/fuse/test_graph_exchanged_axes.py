"""Latitude and longitude that are exchanged are named, and only then."""

from dataclasses import replace

import numpy as np
import pytest

from graph_drives import drive_fixes, odometry_path, simulate_drive
from hubodo.errors import InputError
from hubodo.fuse.graph.batch import fuse_graph
from hubodo.fuse.graph.exchanged_axes import check_exchanged_axes


def exchange(fixes):
    return replace(fixes, latitude_deg=fixes.longitude_deg, longitude_deg=fixes.latitude_deg)


@pytest.mark.parametrize("origin", [(47.37, 8.54), (-33.9, 18.4), (1.3, 80.0)])
def test_exchanged_fixes_are_refused_by_name(origin):
    for seed in range(4):
        drive = simulate_drive(seed, length=150.0, sigma=2.0, origin=origin)
        with pytest.raises(InputError, match="latitude and longitude are exchanged"):
            check_exchanged_axes(odometry_path(drive), exchange(drive_fixes(drive)))


def test_correct_fixes_pass_with_any_drift_of_the_odometry():
    for seed in range(12):
        drive = simulate_drive(seed, length=150.0, sigma=5.0, origin=(47.37, 8.54))
        path = odometry_path(drive)
        for drift in (0.0, 0.01, -0.02):
            turn = np.exp(1j * drift * path.t)
            drifting = np.cumsum(np.append(0.0, np.diff(path.x + 1j * path.y)) * turn)
            check_exchanged_axes(replace(path, x=drifting.real, y=drifting.imag), drive_fixes(drive))


def test_latitudes_beyond_the_pole_are_named():
    drive = simulate_drive(1, length=60.0, origin=(40.0, -110.0))
    with pytest.raises(InputError, match="latitude and longitude look exchanged"):
        fuse_graph(odometry_path(drive), exchange(drive_fixes(drive)))
