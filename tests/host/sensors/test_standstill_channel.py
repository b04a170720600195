"""One channel of a stationary node: temperatures are interpolated, missing channels are named."""

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.recording import Recording, Table
from hubodo.sensors.standstill_channel import interpolate_temperature, read_standstill_channel

T = np.arange(2000) * 0.01
RNG = np.random.default_rng(6)


def recording_of(**columns):
    rates = {name: RNG.normal(0.0, 1e-3, len(T)) for name in ("gx", "gy", "gz")}
    missing = {name: np.full(len(T), np.nan) for name in ("ax", "ay", "az")}
    return Recording({"left": Table({"t": T, **rates, **missing, **columns})})


def test_missing_temperatures_are_interpolated():
    temperature = np.where(np.arange(len(T)) % 10, np.nan, 20.0 + T)
    table = recording_of(temperature=temperature).nodes["left"]
    assert interpolate_temperature(table, np.arange(100)) == pytest.approx(20.0 + np.minimum(T[:100], 0.9))


def test_a_span_of_a_channel_is_returned_and_an_unmeasured_channel_is_named():
    record = read_standstill_channel(recording_of(), "left", "gz", log="night", start=5.0, end=15.0)
    assert record.t[0] == pytest.approx(5.0) and len(record.values) in (1000, 1001)
    with pytest.raises(InputError, match="night: node left has no ax; use --channel with gx, gy, gz"):
        read_standstill_channel(recording_of(), "left", "ax", log="night")


def test_motion_is_refused_or_cut():
    rate = RNG.normal(0.0, 1e-3, len(T)) + np.where((T > 9.0) & (T < 11.0), 0.5, 0.0)
    with pytest.raises(InputError, match="the sensor was moved"):
        read_standstill_channel(recording_of(gz=rate), "left", "gz", log="night")
    record = read_standstill_channel(recording_of(gz=rate), "left", "gz", log="night", cut_disturbances=True)
    assert record.disturbances[0][0] < 9.0 and record.disturbances[-1][1] > 11.0
    with pytest.raises(InputError, match="no samples between --start and --end; they are from 0 to 19"):
        read_standstill_channel(recording_of(), "left", "gz", log="night", start=100.0)
