"""North with a bias that follows the temperature, and the figure of its single estimates."""

from dataclasses import replace

import numpy as np
import pytest

from generators.north_table import Sensor, maytag
from hubodo.recording import Table
from hubodo.sensors.north.axis_record import AxisRecord, fill_temperature
from hubodo.sensors.north.estimates_figure import describe_estimates, estimates_figure
from hubodo.sensors.north.north_estimate import find_north
from hubodo.sensors.north.residuals import compute_residuals
from hubodo.sensors.north.stops import TableMotion

LATITUDE, AZIMUTH, DT = np.radians(50.0), 1.0, 0.2
ANGLES = np.radians(np.cumsum([0.0, *([180.0, -90.0, 180.0, -270.0] * 5)[:19]]))


@pytest.fixture(scope="module")
def warm():
    """Return a record whose bias swings by 100 deg/h at the rate of the programme."""
    rng = np.random.default_rng(8)
    error = Sensor(0.06, 0.5, 0.5).error(3000, DT, rng)
    warmth = 3.0 * np.sin(2.0 * np.pi * np.arange(3000) * DT / 92.0)
    run = maytag(error + np.radians(100.0) / 3600.0 * warmth, DT, AZIMUTH, LATITUDE, ANGLES, 20.0, 3.0)
    motion = TableMotion(run.table_t, run.table_angle, run.table_moving)
    return AxisRecord(run.t, run.rate, motion, temperature=30.0 + warmth[: len(run.t)])


def test_the_temperature_explains_what_would_hide_north(warm):
    result = find_north([warm], LATITUDE, "maytag4", near=AZIMUTH)
    assert result.posterior.uses_temperature
    assert abs(result.azimuth - AZIMUTH) < 3.0 * result.sigma < np.radians(10.0)
    assert result.bound < np.radians(4.0)
    without = find_north([replace(warm, temperature=None)], LATITUDE, "maytag4", near=AZIMUTH)
    assert without.sigma > 5.0 * result.sigma


def test_a_temperature_that_explains_nothing_is_left_out(warm):
    calm = replace(warm, temperature=np.random.default_rng(1).permutation(warm.temperature))
    assert not find_north([calm], LATITUDE, "maytag4", near=AZIMUTH).posterior.uses_temperature


def test_the_figure_shows_pairs_their_deviation_and_the_temperature(warm):
    result = find_north([warm], LATITUDE, "maytag4", near=AZIMUTH)
    figure = estimates_figure(result)
    assert [axes.get_xlabel() for axes in figure.axes][-1] == "temperature, °C" and len(figure.axes) == 3
    pairs = figure.axes[0].lines[0].get_ydata()
    assert len(pairs) == len(result.rates)
    residuals = compute_residuals(result)
    slope = np.polyfit(residuals.temperature, residuals.rate, 1)[0]
    assert slope == pytest.approx(np.radians(100.0) / 3600.0, rel=0.05)
    assert describe_estimates(result).startswith("Rate of each pair")
    cold = find_north([replace(warm, temperature=None)], LATITUDE, "maytag4", near=AZIMUTH)
    assert len(estimates_figure(cold).axes) == 2


def test_unknown_temperatures_are_interpolated():
    t = np.arange(4.0)
    node = Table({"t": t, "temperature": np.array([20.0, np.nan, 22.0, np.nan])})
    np.testing.assert_allclose(fill_temperature(node), [20.0, 21.0, 22.0, 22.0])
    assert fill_temperature(Table({"t": t})) is None
