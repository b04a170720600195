"""Effects that a model has already: their values are refined, and the gap never grows."""

from dataclasses import replace

import numpy as np
import pytest

import wanted
from gap_matrix.make_case import write_case
from gap_runs import run_gap
from hubodo.effects import BY_NAME
from hubodo.gap.judge.held_out import HeldOutResidual
from hubodo.gap.judge.round import judge_round
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.residual import compute_gap
from hubodo.gap.refit.refit import refit_with_weights
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm
from hubodo.gap.workflow import _MAX_MINOR_CHANGE, _best_stage, _with_refinements_last
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model
from hubodo.recording import Table
from repetitions import first_and_more

# Learnt by `gap` on drive-1 from geometry and noise alone.
CAR = """
[vehicle]
wheel_radius = 0.2924
track_width = 1.42
[imu]
gyro_noise = 0.025
accel_noise = 1.2
[inputs]
speed = "nodes"
yaw_rate = "frame.gz"
[effects.road_bank]
sigma = 0.0189
length = 500.0
[effects.accel_bias]
z = 0.332
[nodes.left]
side = "left"
facing = "left"
[nodes.left.effects.lever_arm]
x = 0.00683
y = -0.01028
[nodes.left.effects.node_misalignment]
x = 0.00275
y = 0.01911
[nodes.left.effects.gyro_bias]
x = -0.0549
y = -0.0512
z = -0.043
[nodes.right]
side = "right"
facing = "right"
[nodes.right.effects.lever_arm]
x = 0.00214
y = -0.00545
[nodes.right.effects.node_misalignment]
x = -0.01324
y = -0.00526
[nodes.right.effects.gyro_bias]
x = 0.0389
y = 0.0072
z = 0.0577
"""


@pytest.mark.parametrize(
    ("scope", "heading"), first_and_more(("left", "nodes.left.effects"), ("all", "effects"))
)
def test_a_wrong_value_in_the_model_file_is_refined_and_the_old_one_given(scope, heading, tmp_path):
    seed = 11
    (hidden,) = write_case(
        tmp_path / "log", seed, ["gyro_bias"], "strong", scope=scope, duration=33.0, rate_hz=30.0
    )
    model = tmp_path / "log" / "model.toml"
    wrong = {axis: 0.4 * value for axis, value in hidden.parameters.items()}
    values = "\n".join(f"{axis} = {value}" for axis, value in wrong.items())
    model.write_text(f"{model.read_text('utf-8')}\n[{heading}.gyro_bias]\n{values}\n", "utf-8")
    run = run_gap(tmp_path / "out", model, tmp_path / "log")
    assert run.names == [("gyro_bias", scope)], run.out
    for axis, estimate in run.result["found"][0]["parameters"].items():
        assert estimate["was"] == pytest.approx(wrong[axis])
        assert estimate["change"] == pytest.approx(estimate["value"] - estimate["was"])
        assert abs(estimate["value"] - hidden.parameters[axis]) < 4.0 * estimate["sigma"] + 1e-4
    again = run_gap(tmp_path / "again", tmp_path / "out" / "model.toml", tmp_path / "log")
    assert again.names == []


def held_out(gap, *growth):
    """Return the residual of eight held-out blocks of 1000 samples of this gap, plus a growth of squares."""
    squares = np.full(8, 1000.0 * gap**2) + np.array(growth or [0.0] * 8)
    return HeldOutResidual(gap, squares)


def best_stage(gaps, held_out_gaps):
    return _best_stage(gaps, [held_out(gap) for gap in held_out_gaps])


def test_of_a_search_whose_gap_grew_the_best_part_remains():
    assert best_stage([3.0, 2.0, 1.0], [3.0, 2.0, 1.0]) == 2
    assert best_stage([3.0, 2.0, 3.1], [3.0, 2.0, 1.0]) == 1
    assert best_stage([3.0, 2.0, 1.0], [3.0, 2.5, 3.2]) == 1
    assert best_stage([3.0, 3.5], [3.0, 3.5]) == 0
    nothing = HeldOutResidual(np.nan, np.empty(0))
    assert _best_stage([3.0, 2.0], [nothing, nothing]) == 1


def test_a_growth_on_held_out_samples_counts_beyond_its_scatter():
    """A camber of 1 mrad in the noise of a real road, with growth in eight blocks of time."""
    by_chance = held_out(0.713, -3.7, -0.9, 0.1, 7.0, -1.4, -8.8, 2.6, 10.0)
    steady = held_out(0.713, 0.3, 0.8, 0.5, 0.9, 0.4, 0.7, 0.6, 0.8)
    assert _best_stage([0.6583, 0.6574], [held_out(0.713), by_chance]) == 1
    assert _best_stage([0.6583, 0.6574], [held_out(0.713), steady]) == 0


def test_refinements_of_the_model_are_given_up_before_new_effects(problem):
    bias, lag = (BY_NAME[name]() for name in ("gyro_bias", "gyro_lag"))
    given = State(problem, (ModelTerm(bias, "left", is_fitted=False),))
    terms = [ModelTerm(bias, "left"), ModelTerm(lag, "left"), ModelTerm(bias, "right")]
    assert [term.key for term in _with_refinements_last(given, terms)] == [
        ("gyro_lag", "left"),
        ("gyro_bias", "right"),
        ("gyro_bias", "left"),
    ]


def test_an_effect_that_the_held_out_condition_does_not_show_stays():
    """Saturation of the fastest turn: rounding of the filter changes the gap elsewhere by 5e-6 of it."""
    assert best_stage([2.35128, 2.04242], [1.97809, 1.97810]) == 1
    assert best_stage([2.35128, 2.04242], [1.97809, 1.97850]) == 0


def select_samples(recording, duration, stride):
    """Return each `stride`-th sample of the first `duration` seconds of each node."""
    nodes = {}
    for name, table in recording.nodes.items():
        samples = np.flatnonzero(table.t < table.t[0] + duration)[::stride]
        nodes[name] = Table({column: table[column][samples] for column in table})
    return replace(recording, nodes=nodes)


@pytest.mark.parametrize(
    ("duration", "stride"), first_and_more((60.0, 2), (np.inf, 1)), ids=["first minute", "whole"]
)
def test_the_model_of_one_real_drive_holds_on_the_next(duration, stride, tmp_path):
    """The first round names an effect of the drive, or refines one of the model as little as drives differ.

    In the first minute three effects gain 200 in log-likelihood, which held-out samples leave in doubt.
    `make gap-real` runs the whole search, with the models of both drives.
    """
    (tmp_path / "model.toml").write_text(CAR, "utf-8")
    recording = select_samples(read_folder(wanted.recording("car") / "drive-2"), duration, stride)
    problem = build_problem(recording, read_model(tmp_path / "model.toml"), "drive-2")
    fit = refit_with_weights(build_initial_state(problem))
    best = judge_round(fit.evaluation).best
    print(f"gap {compute_gap(fit.evaluation.residuals):.3f}; {best and best.term}")
    if best is not None and not best.term.effect.varies_between_drives:
        (before,) = [term.effect for term in fit.state.terms if term.key == best.term.key]
        for name, value in best.term.effect.values().items():
            change = abs(value - before.values()[name])
            assert change < _MAX_MINOR_CHANGE * before.scale(name), name
