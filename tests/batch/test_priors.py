"""Priors of a fleet: median over vehicles and spread between them, in a file that verbs read."""

import numpy as np
import pytest

from batch.fleet_logs import FleetLog, write
from hubodo.calibration.file import CalibratedEffect, Calibration, Quantity, read_calibration
from hubodo.errors import InputError
from hubodo.fleet.priors import fleet_calibration
from in_process import hubodo


def calibration_of(bias, sigma):
    return Calibration().with_node(
        "left", {"gyro_bias": CalibratedEffect({"z": Quantity(bias, sigma)})}, "A1"
    )


def bias_of(calibration):
    return calibration.nodes["left"].effects["gyro_bias"].parameters["z"]


def test_the_sigma_is_the_spread_between_vehicles_and_poor_calibrations_have_little_weight():
    rng = np.random.default_rng(4)
    true = rng.normal(0.02, 0.005, 400)
    fleet = {
        f"van-{k}": [calibration_of(bias, 1e-4), calibration_of(bias + 1.0, 1.0)]
        for k, bias in enumerate(true)
    }
    prior = bias_of(fleet_calibration(fleet))
    assert prior.value == pytest.approx(0.02, abs=3 * 1.25 * 0.005 / 20)
    assert prior.sigma == pytest.approx(0.005, rel=0.2)
    assert fleet_calibration(fleet).nodes["left"].serial == ""


def test_equal_calibrations_do_not_reduce_the_sigma_and_two_vehicles_give_no_prior():
    assert bias_of(fleet_calibration({name: [calibration_of(0.02, 1e-3)] for name in "abc"})).sigma == 1e-3
    with pytest.raises(InputError, match="3 vehicles or more"):
        fleet_calibration({name: [calibration_of(0.02, 1e-3)] for name in "ab"})


@pytest.mark.repeat
def test_priors_are_written_on_request_as_a_calibration_file(tmp_path, here):
    for number in range(3):
        log = FleetLog(f"van-{number}", number, 150.0, 50.0, 0.01 + 0.002 * number, 0.03, seed=number)
        write(tmp_path / "logs", log)
    words = ["batch", "warmup", tmp_path / "logs", "-o", tmp_path / "out", *here]
    assert hubodo(*words).code == 0
    assert not (tmp_path / "out" / "priors.toml").exists()
    assert hubodo(*words, "--priors").code == 0
    effects = read_calibration(tmp_path / "out" / "priors.toml").nodes["left"].effects
    bias, warmup = effects["gyro_bias"].parameters["z"], effects["gyro_warmup"].parameters
    assert bias.value + warmup["z"].value == pytest.approx(0.012, abs=3e-4)
    assert bias.sigma == pytest.approx(1.4826 * 0.002, rel=0.2)
    assert warmup["z"].value == pytest.approx(-0.03, abs=1e-3)
    assert warmup["time_constant"].value == pytest.approx(30.0, rel=0.2)
    assert hubodo("batch", "info", tmp_path / "logs", "-o", tmp_path / "x", "--priors").code == 2
