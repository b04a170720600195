"""A clock that runs fast is attributed to its node, on a real drive whose speed the wheels measure."""

from itertools import product

import pytest
from car import read_car_model, read_drive
from sample_effects import injections

from hubodo.effects import BY_NAME
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.residual import compute_gap
from hubodo.gap.refit.refit import refit_with_weights
from hubodo.gap.state.terms import ModelTerm

VEHICLE = ("gyro_bias", "node_misalignment", "lever_arm", "gyro_scale_factor")
STRONG = next(
    one for one in injections(30.0, 0.025, 1.2) if (one.effect, one.strength) == ("clock_skew", "strong")
)


@pytest.fixture(scope="module")
def fit_gap(tmp_path_factory):
    """Return a function that fits the vehicle, and perhaps a clock, to a drive: gap, skew in ppm."""
    model = read_car_model(tmp_path_factory.mktemp("car"))

    def fit(recording, wheel="", ppm=0.0):
        state = build_initial_state(build_problem(recording, model))
        for name, node in product(VEHICLE, ("left", "right")):
            state = state.with_term(ModelTerm(BY_NAME[name](), node))
        if wheel:
            state = state.with_term(ModelTerm(BY_NAME["clock_skew"](ppm), wheel))
        fitted = refit_with_weights(state)
        skews = [term.effect.ppm for term in fitted.state.terms if term.key == ("clock_skew", wheel)]
        return compute_gap(fitted.evaluation.residuals), (*skews, 0.0)[0]

    return fit


@pytest.fixture(scope="module")
def recorded_gap(fit_gap):
    """Return the gap of the drive as recorded."""
    return fit_gap(read_drive("drive-1"))[0]


@pytest.mark.parametrize(("node", "other"), [("left", "right"), ("right", "left")])
def test_a_fast_clock_fits_on_its_own_node_alone(fit_gap, recorded_gap, node, other):
    """The yaw rate of the body shows which of the two wheels that measure the speed has the wrong clock."""
    recording = STRONG.apply(read_drive("drive-1"), node, seed=1)
    gap, ppm = fit_gap(recording, node, 1000.0)
    gap_of_other, ppm_of_other = fit_gap(recording, other, -1000.0)
    print(recorded_gap, gap, ppm, gap_of_other, ppm_of_other)
    assert gap < 1.002 * recorded_gap
    assert gap_of_other > 1.01 * gap
    assert ppm == pytest.approx(STRONG.parameters["ppm"], abs=150.0), "the clocks differ as recorded"
