"""UTM zones and the local frame, against geodesics and Earth-centred coordinates."""

import numpy as np
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hubodo.errors import InputError
from hubodo.fuse.projection import find_epsg, make_local_frame

WGS84 = pyproj.Geod(ellps="WGS84")
TO_EARTH_CENTRED = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978")


@pytest.mark.parametrize(
    ("latitude", "longitude", "epsg"),
    [
        (47.37, 8.54, 32632),
        (-33.9, 18.4, 32734),
        (22.3, 87.3, 32645),
        (0.0, 0.0, 32631),
        (10.0, 180.0, 32601),
        (10.0, -180.0, 32601),
        (10.0, 179.9, 32660),
        (60.4, 5.3, 32632),  # Bergen: zone 32 is widened
        (78.2, 15.6, 32633),  # Svalbard: 33 reaches from 9 to 21
        (78.2, 8.9, 32631),
        (78.2, 21.0, 32635),
        (78.2, 33.0, 32637),
        (78.2, 42.0, 32638),
        (56.0, 3.0, 32632),
        (64.0, 3.0, 32631),
        (72.0, 9.0, 32633),
        (71.9, 9.0, 32632),
        (-0.1, 6.0, 32732),
        (83.9, 8.0, 32631),
        (-80.0, 0.0, 32731),
        (85.0, 0.0, 32661),
        (-85.0, 50.0, 32761),
    ],
)
def test_the_zone_is_that_of_the_grid_reference_system(latitude, longitude, epsg):
    assert find_epsg(latitude, longitude) == epsg


@settings(max_examples=40, deadline=None)
@given(
    latitude=st.floats(-79.0, 83.0),
    longitude=st.floats(-180.0, 180.0),
    bearing=st.floats(0.0, 360.0),
    distance=st.floats(1.0, 2000.0),
)
def test_metres_and_bearings_are_those_of_the_geodesic(latitude, longitude, bearing, distance):
    frame = make_local_frame(latitude, longitude)
    lon, lat, _ = WGS84.fwd(longitude, latitude, bearing, distance)
    x, y = (float(v[0]) for v in frame.to_local(np.array([lat]), np.array([lon])))
    east, north = distance * np.sin(np.radians(bearing)), distance * np.cos(np.radians(bearing))
    # The curvature of the grid meridians over 2 km grows towards the pole as tan(latitude) d² / (2 R).
    tolerance = 1e-3 + distance**2 / 6.37e6 * (1.0 + abs(np.tan(np.radians(latitude))))
    assert np.hypot(x - east, y - north) < tolerance


def test_the_local_frame_agrees_with_earth_centred_coordinates_in_the_corner_of_a_zone():
    """The convergence is 2.6° there; without correction a point at 250 m would be displaced by 11 m."""
    latitude, longitude = 59.9, 11.95
    frame = make_local_frame(latitude, longitude)
    lat, lon = latitude + np.array([1e-4, 2e-3, -1.5e-3]), longitude + np.array([4e-3, -2e-3, 1e-3])
    target = np.array(TO_EARTH_CENTRED.transform(lat, lon, 0.0 * lat)).T - TO_EARTH_CENTRED.transform(
        latitude, longitude, 0.0
    )
    phi, lam = np.radians(latitude), np.radians(longitude)
    east = target @ [-np.sin(lam), np.cos(lam), 0.0]
    north = target @ [-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)]
    x, y = frame.to_local(lat, lon)
    assert abs(np.degrees(frame.convergence)) > 2.5
    assert np.max(np.hypot(x - east, y - north)) < 0.01


def test_to_geodetic_is_the_inverse_of_to_local():
    frame = make_local_frame(-33.9, 18.4)
    x, y = np.array([0.0, 1234.5, -800.0]), np.array([10.0, -3.25, 900.0])
    round_trip = frame.to_local(*frame.to_geodetic(x, y))
    assert np.allclose(round_trip, (x, y), atol=1e-6)


@pytest.mark.parametrize("border", [12.0, 179.9999, -180.0])
def test_a_drive_across_a_zone_border_is_continuous(border):
    frame = make_local_frame(47.0, border)
    lon = border + np.linspace(-0.01, 0.01, 201)
    x, y = frame.to_local(np.full(201, 47.0), (lon + 180.0) % 360.0 - 180.0)
    # Steps of 7.6 m; the scale of the grid changes by 1e-5 per km at its edge, a change of zone by
    # kilometres.
    assert np.ptp(np.diff(x)) < 2e-4
    # A parallel curves away from east: 200 x 7.6^2 tan(47 deg) / R = 1.9 mm.
    assert np.ptp(np.diff(y)) < 2.5e-3


@pytest.mark.parametrize("place", [(90.5, 0.0), (float("nan"), 0.0), (0.0, float("inf"))])
def test_a_place_that_is_not_on_earth_is_refused(place):
    with pytest.raises(InputError, match="not on Earth"):
        make_local_frame(*place)
