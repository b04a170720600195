"""Noise parameters for kalibr and imu_filter_madgwick, compared with the injected noise."""

import math

import numpy as np
import pytest
import yaml

from in_process import hubodo

RATE_HZ, DURATION, SEED = 100, 600, 6
GYRO_DENSITY, GYRO_WALK = 3e-4, 4e-5  # rad/s/√Hz, rad/s²/√Hz
ACCEL_DENSITY, ACCEL_WALK = 2e-3, 3e-4  # m/s²/√Hz, m/s³/√Hz


def simulated_axis(rng, density, walk):
    """Noise as kalibr defines it: white samples of σ/√dt, and a bias whose steps have σ_b·√dt."""
    n, dt = RATE_HZ * DURATION, 1.0 / RATE_HZ
    return density / math.sqrt(dt) * rng.normal(size=n) + np.cumsum(walk * math.sqrt(dt) * rng.normal(size=n))


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("noise"), np.random.default_rng(SEED)
    t = np.arange(RATE_HZ * DURATION) / RATE_HZ
    # Axes with different noise: the files contain the root mean square.
    gyro = [scale * simulated_axis(rng, GYRO_DENSITY, GYRO_WALK) for scale in (0.5, 1.0, 1.5)]
    accel = [simulated_axis(rng, ACCEL_DENSITY, ACCEL_WALK) + up for up in (0.0, 0.0, 9.81)]
    np.savetxt(
        folder / "hub.csv",
        np.column_stack([t, *gyro, *accel]),
        delimiter=",",
        header="t,gx,gy,gz,ax,ay,az",
        comments="",
    )
    options = ("--trust-still", "--kalibr", folder / "imu.yaml", "--imu-filter", folder / "filter.yaml")
    done = hubodo("allan", folder / "hub.csv", *options)
    assert done.code == 0, done.err
    return [yaml.safe_load((folder / name).read_text()) for name in ("imu.yaml", "filter.yaml")]


def test_kalibr_gets_the_densities_and_random_walks_that_were_injected(files):
    kalibr, _ = files
    # 1σ of the fit of one axis in this record: 0.6 % of N, 20 % of K.
    rms_scale = math.sqrt((0.5**2 + 1.0 + 1.5**2) / 3)
    assert kalibr["gyroscope_noise_density"] == pytest.approx(rms_scale * GYRO_DENSITY, rel=0.02)
    assert kalibr["accelerometer_noise_density"] == pytest.approx(ACCEL_DENSITY, rel=0.02)
    assert kalibr["gyroscope_random_walk"] == pytest.approx(rms_scale * GYRO_WALK, rel=0.3)
    assert kalibr["accelerometer_random_walk"] == pytest.approx(ACCEL_WALK, rel=0.3)
    assert (kalibr["rostopic"], kalibr["update_rate"]) == ("/hub/imu", RATE_HZ)
    assert len(kalibr) == 6


def test_the_madgwick_filter_gets_the_noise_of_a_sample_as_gain(files):
    kalibr, parameters = files
    (node,) = parameters.values()
    gain, zeta = node["ros__parameters"]["gain"], node["ros__parameters"]["zeta"]
    assert gain == pytest.approx(
        math.sqrt(0.75) * kalibr["gyroscope_noise_density"] * math.sqrt(RATE_HZ), rel=1e-5
    )
    assert zeta == pytest.approx(math.sqrt(0.75) * kalibr["gyroscope_random_walk"], rel=1e-5)
    assert list(parameters) == ["/**"]


def test_several_nodes_have_no_common_file(tmp_path):
    rows = "t,gx,gy,gz,ax,ay,az\n" + "".join(f"{k / 10},0.1,0.2,{k % 7},0,0,9.8\n" for k in range(600))
    for name in ("left", "right"):
        (tmp_path / f"{name}.csv").write_text(rows)
    options = ("--node", "all", "--trust-still", "--trust-units", "--kalibr", tmp_path / "imu.yaml")
    done = hubodo("allan", tmp_path, *options)
    assert done.code == 2 and "describe one node" in done.err
    assert not (tmp_path / "imu.yaml").exists()
