"""Plans of north measurements: longer ones are better, and the target is the shortest that suffices."""

import json

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.north_estimate import horizontal_earth_rate
from hubodo.sensors.north.plan import drift_noise_from_standstill, plan_stops, read_drift_noise
from hubodo.sensors.north.programme import programme_sigma

NOISE, LATITUDE_DEG = DriftNoise(3e-5, 1e-6, 0.0), 46.7
HORIZONTAL = horizontal_earth_rate(np.radians(LATITUDE_DEG))


def test_the_target_reaches_its_sigma_and_longer_programmes_are_better():
    plan = plan_stops(NOISE, LATITUDE_DEG, 3.0, turn=2.0)
    sigmas = [programme.sigma for programme, _ in plan.programmes]
    assert sigmas == sorted(sigmas, reverse=True) and len(sigmas) > 2
    target = plan.target_programme
    assert target.sigma <= np.radians(3.0)
    assert programme_sigma(NOISE, target.stop, target.count, 2.0, HORIZONTAL) == pytest.approx(target.sigma)


def test_noise_is_read_from_an_allan_result_and_refused_from_other_files(tmp_path):
    path = tmp_path / "allan.json"
    path.write_text(json.dumps({"coefficients": {name: {"value": 1e-4} for name in "NBK"}}))
    assert read_drift_noise(path) == DriftNoise(1e-4, 1e-4, 1e-4)
    path.write_text("{}")
    with pytest.raises(InputError, match="is not an output of hubodo allan"):
        read_drift_noise(path)


def test_noise_is_estimated_from_a_standstill():
    t = np.arange(1 << 14) * 0.1
    rate = np.random.default_rng(2).normal(0.0, 1e-3, len(t))
    assert drift_noise_from_standstill(t, rate, "gz").n == pytest.approx(1e-3 * np.sqrt(0.1), rel=0.05)
