"""Tracks as files of other programs, read by scipy rotations, geodesics, XML and JSON."""

import json
import xml.etree.ElementTree as ElementTree
from datetime import datetime

import numpy as np
import pytest
from pyproj import Geod
from scipy.spatial.transform import Rotation

from hubodo.errors import InputError
from hubodo.fuse.track_files import TRACK_WRITERS, ExportedTrack

START = 1_790_000_000.25
N = 200
HEADING = np.linspace(-4.0, 5.0, N)
TRACK = ExportedTrack(
    "loop <1> & 2",
    START + 0.1 * np.arange(N),
    np.linspace(0.0, 300.0, N),
    80.0 * np.sin(np.linspace(0.0, 3.0, N)),
    HEADING,
    (47.4, 8.55),
)


def table(text):
    return np.array([[float(cell) for cell in line.split(" ")] for line in text.splitlines()])


def test_tum_has_times_positions_and_unit_quaternions():
    rows = table(TRACK_WRITERS["tum"](TRACK))
    assert rows.shape == (N, 8)
    np.testing.assert_allclose(rows[:, 0], TRACK.t, rtol=0, atol=1e-6)
    np.testing.assert_allclose(rows[:, 1:4], np.column_stack([TRACK.x, TRACK.y, 0 * TRACK.x]), atol=1e-8)
    expected = Rotation.from_euler("z", HEADING[:, None]).as_matrix()
    np.testing.assert_allclose(Rotation.from_quat(rows[:, 4:]).as_matrix(), expected, atol=1e-11)


def test_kitti_has_the_matrix_of_each_pose():
    rows = table(TRACK_WRITERS["kitti"](TRACK)).reshape(N, 3, 4)
    np.testing.assert_allclose(
        rows[:, :, :3], Rotation.from_euler("z", HEADING[:, None]).as_matrix(), atol=1e-11
    )
    np.testing.assert_allclose(rows[:, :2, 3], np.column_stack([TRACK.x, TRACK.y]), atol=1e-8)


def positions(name):
    """Return latitudes, longitudes and ISO times of a map file, None where it has no times."""
    text = TRACK_WRITERS[name](TRACK)
    if name == "geojson":
        (feature,) = json.loads(text)["features"]
        assert feature["geometry"]["type"] == "LineString"
        longitude, latitude = np.transpose(feature["geometry"]["coordinates"])
        return latitude, longitude, feature["properties"]["coordTimes"], feature["properties"]["name"]
    root = ElementTree.fromstring(text)
    space = {"gpx": "{http://www.topografix.com/GPX/1/1}", "kml": "{http://www.opengis.net/kml/2.2}"}[name]
    title = next(root.iter(space + "name")).text
    if name == "kml":
        points = next(root.iter(space + "coordinates")).text.split()
        longitude, latitude = np.transpose([[float(cell) for cell in point.split(",")] for point in points])
        return latitude, longitude, None, title
    points = list(root.iter(space + "trkpt"))
    latitude, longitude = (np.array([float(point.get(key)) for point in points]) for key in ("lat", "lon"))
    return latitude, longitude, [point.find(space + "time").text for point in points], title


@pytest.mark.parametrize("name", ["gpx", "kml", "geojson"])
def test_map_files_have_the_position_on_the_ellipsoid(name):
    latitude, longitude, times, title = positions(name)
    assert title == "loop <1> & 2"
    azimuth, _, distance = Geod(ellps="WGS84").inv(np.full(N, 8.55), np.full(N, 47.4), longitude, latitude)
    np.testing.assert_allclose(distance, np.hypot(TRACK.x, TRACK.y), atol=2e-3)
    east, north = distance * np.sin(np.radians(azimuth)), distance * np.cos(np.radians(azimuth))
    np.testing.assert_allclose(np.column_stack([east, north]), np.column_stack([TRACK.x, TRACK.y]), atol=2e-2)
    if times is not None:
        stamps = [datetime.fromisoformat(time).timestamp() for time in times]
        np.testing.assert_allclose(stamps, TRACK.t, rtol=0, atol=6e-4)


def test_map_files_need_a_position_on_earth():
    track = ExportedTrack("drive", TRACK.t, TRACK.x, TRACK.y, HEADING)
    with pytest.raises(InputError, match="--origin"):
        TRACK_WRITERS["gpx"](track)
