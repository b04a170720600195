"""A log that is sampled fast is searched with some of its samples first, and loses nothing by it."""

import numpy as np

from gap_matrix import cases, effects, recording
from gap_runs import gap
from hubodo.gap.problem.build import build_problem
from hubodo.gap.problem.problem import CHANNELS, Problem
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

SEED, SECONDS = 9, 33.0


def sampled(folder, rate_hz):
    """A folder: a sensor off the axle, and samples that come twice."""
    setup = cases.setup(SEED, duration=SECONDS)
    setup = cases.sampled_at(setup, rate_hz, np.random.default_rng(SEED), jitter=0.02)
    hidden = [
        cases.hidden_effect(setup, "lever_arm", "left"),
        cases.hidden_effect(setup, "sample_repeat", "left"),
    ]
    hidden[1] = effects.scaled(hidden[1], 5.0)
    recording.write(setup, hidden, folder, {})
    return folder


def problem_of(folder):
    return build_problem(read_folder(folder), read_model(folder / "model.toml"))


def test_every_fourth_sample_stays_and_the_inputs_are_left_whole(tmp_path):
    whole = problem_of(sampled(tmp_path, 400.0))
    light = whole.decimate()
    for few, all_of_them in zip(light.nodes, whole.nodes, strict=True):
        assert (few.t == all_of_them.t[::4]).all()
        assert (few.y == all_of_them.y[:, ::4]).all()
        assert few.forward.inputs is all_of_them.forward.inputs
    assert light.decimate() is None


def test_what_shows_in_the_mean_and_what_shows_from_sample_to_sample_are_both_found(tmp_path):
    case = sampled(tmp_path / "case", 200.0)
    made = gap(tmp_path / "out", case / "model.toml", case)
    assert sorted(made.names) == [("lever_arm", "left"), ("sample_repeat", "left")]
    repeated = next(it for it in made.result["found"] if it["effect"] == "sample_repeat")
    value = repeated["parameters"]["probability"]
    assert abs(value["value"] - 0.05) < 4.0 * value["sigma"]


def test_a_log_at_fifty_hertz_is_not_decimated_and_every_node_keeps_its_channels(problem):
    assert isinstance(problem, Problem) and problem.decimate() is None
    part = problem.select({node.name: slice(0, 50) for node in problem.nodes})
    assert [node.y.shape for node in part.nodes] == [(len(CHANNELS), 50)] * 2
