"""Decimation: a fast log is searched with a part of its samples first, and no effect is missed."""

import numpy as np

from gap_matrix import cases, effects, recording
from gap_runs import run_gap
from hubodo.gap.problem.build import build_problem
from hubodo.gap.problem.problem import CHANNELS, Problem
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

SEED, DURATION = 9, 33.0  # s


def write_sampled_case(folder, rate_hz):
    """Write a case with a lever arm and repeated samples on the left node."""
    setup = cases.draw_setup(SEED, duration=DURATION)
    setup = cases.resample_nodes(setup, rate_hz, np.random.default_rng(SEED), jitter=0.02)
    hidden = [
        cases.draw_hidden_effect(setup, "lever_arm", "left"),
        cases.draw_hidden_effect(setup, "sample_repeat", "left"),
    ]
    hidden[1] = effects.scale_effect(hidden[1], 5.0)
    recording.write_case_files(setup, hidden, folder, {})
    return folder


def read_problem(folder):
    """Return the gap problem of a case folder."""
    return build_problem(read_folder(folder), read_model(folder / "model.toml"))


def test_decimation_takes_every_fourth_sample_and_all_inputs(tmp_path):
    problem = read_problem(write_sampled_case(tmp_path, 400.0))
    decimated = problem.decimate()
    for decimated_node, node in zip(decimated.nodes, problem.nodes, strict=True):
        assert (decimated_node.t == node.t[::4]).all()
        assert (decimated_node.y == node.y[:, ::4]).all()
        assert decimated_node.forward.inputs is node.forward.inputs
    assert decimated.decimate() is None


def test_an_effect_on_the_mean_and_one_on_single_samples_are_both_found(tmp_path):
    case = write_sampled_case(tmp_path / "case", 104.0)
    run = run_gap(tmp_path / "out", case / "model.toml", case, page=True)
    assert sorted(run.names) == [("lever_arm", "left"), ("sample_repeat", "left")]
    repeated = next(finding for finding in run.result["found"] if finding["effect"] == "sample_repeat")
    value = repeated["parameters"]["probability"]
    assert abs(value["value"] - 0.05) < 4.0 * value["sigma"]


def test_a_log_at_fifty_hertz_is_not_decimated_and_every_node_keeps_its_channels(problem):
    assert isinstance(problem, Problem) and problem.decimate() is None
    part = problem.select({node.name: slice(0, 50) for node in problem.nodes})
    assert [node.y.shape for node in part.nodes] == [(len(CHANNELS), 50)] * 2
