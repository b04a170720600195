"""North estimates against the bound for known noise from an independent generator (more in `make papers`)."""

import numpy as np
import pytest
from scipy.stats import chi2

from generators.noise import gyro_noise
from generators.north_table import maytag
from hubodo.sensors.north.axis_record import AxisRecord
from hubodo.sensors.north.circular import wrap_angle
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.north_estimate import find_north
from hubodo.sensors.north.stops import TableMotion
from repetitions import first_and_more

LATITUDE = np.radians(45)
DT, STOP, STOPS, SEEDS = 0.1, 16.0, 16, 20
NOISES = {
    "white": {"n": 3e-5},
    "flicker": {"n": 3e-5, "b": 1.2e-5},
    "walk": {"n": 3e-5, "k": 1e-6},
    "ramp": {"n": 3e-5, "r": 3e-7},
}


def runs(noise):
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        azimuth = rng.uniform(-np.pi, np.pi)
        error = gyro_noise(int(STOPS * (STOP + 2) / DT) + 10, DT, rng, **noise)
        angles = list(np.resize([0.0, np.pi, np.pi / 2, 1.5 * np.pi], STOPS))
        run = maytag(error, DT, azimuth, LATITUDE, angles, STOP, 2.0)
        yield (
            azimuth,
            AxisRecord(run.t, run.rate, TableMotion(run.table_t, run.table_angle, run.table_moving)),
        )


@pytest.mark.parametrize("name", ["flicker", *first_and_more("walk", "white"), "ramp"])
def test_azimuth_is_within_a_tenth_of_the_bound_and_sigma_holds(name):
    noise = NOISES[name]
    drift = DriftNoise(noise["n"], noise.get("b", 0.0), noise.get("k", 0.0))
    ours, reported, z = [], [], []
    for azimuth, record in runs(noise):
        result = find_north([record], LATITUDE, "maytag4", settle=0.3)
        knowing = find_north([record], LATITUDE, "maytag4", settle=0.3, drift=drift)
        ours.append(float(wrap_angle(result.azimuth - azimuth)))
        reported.append(float(wrap_angle(knowing.azimuth - azimuth)))
        z.append(ours[-1] / result.sigma)
        bound = knowing.bound
    ratio = np.sqrt(np.mean(np.square(ours)) / np.mean(np.square(reported)))
    print(name, ratio, np.degrees(bound), np.mean(np.square(z)), f"seeds 0 to {SEEDS - 1}")
    assert ratio < 1.1
    # The estimator that knows the noise is at the bound: chi-square, 99.9 %.
    low, high = chi2.ppf([0.0005, 0.9995], SEEDS) / SEEDS
    assert low < np.mean(np.square(reported)) / bound**2 < high
    assert low < np.mean(np.square(z)) < high
