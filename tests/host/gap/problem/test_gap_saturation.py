"""Speed measured by the gyros of two wheels, one of which saturates."""

from dataclasses import replace

import numpy as np
import pytest

from hubodo.gap.problem.build import build_problem
from hubodo.gap.problem.saturation import find_saturation_limit, weigh_speed_sources
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model
from hubodo.recording import Table

GYRO = ("gx", "gy", "gz")


def test_readings_that_pile_up_at_a_value_saturate_there_and_noise_does_not():
    y = 3.0 * np.random.default_rng(1).standard_normal((3, 2000))
    assert find_saturation_limit(y) == np.inf
    assert find_saturation_limit(np.clip(y, -4.0, 4.0)) == 4.0


def test_a_saturated_gyro_has_no_weight_unless_all_are_saturated():
    t = np.arange(4.0)
    left, right = np.array([0, 0, 1, 1], bool), np.array([0, 1, 0, 1], bool)
    weights = weigh_speed_sources(t, [(t, left), (t, right)])
    np.testing.assert_array_equal(weights, [[0.5, 1.0, 0.0, 0.5], [0.5, 0.0, 1.0, 0.5]])


@pytest.mark.parametrize("saturated", ("left", "right"))
def test_the_speed_comes_from_the_wheel_whose_gyro_is_not_saturated(clean_log, saturated):
    recording, model = read_folder(clean_log), read_model(clean_log / "model.toml")
    model = replace(model, inputs=replace(model.inputs, speed="nodes"))
    table = recording.nodes[saturated]
    limit = 0.7 * float(np.abs(table["gz"]).max())
    clipped = {name: np.clip(table[name], -limit, limit) for name in GYRO}
    columns = {name: table[name] for name in ("ax", "ay", "az")}
    changed = Table({"t": table.t, **columns, **clipped})
    problems = [
        build_problem(one, model)
        for one in (
            recording,
            replace(recording, nodes={**recording.nodes, saturated: changed}),
        )
    ]
    true_speed, speed = (problem.inputs.speed(table.t - table.t[0]) for problem in problems)
    excess = model.vehicle.wheel_radius * (np.abs(table["gz"]) - limit)
    is_clipped = excess > 0.0
    assert is_clipped.sum() > 50
    # A plain mean would lack half of the excess.
    error = np.sqrt(np.mean((speed - true_speed)[is_clipped] ** 2))
    assert error < 0.1 * np.sqrt(np.mean((0.5 * excess[is_clipped]) ** 2))
