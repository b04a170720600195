"""Decimation: a fast log is searched with a part of its samples first, and no effect is missed."""

import numpy as np

from gap_matrix import cases, effects, recording
from hubodo.gap.problem.build import build_problem
from hubodo.gap.problem.problem import CHANNELS, Problem
from hubodo.gap.workflow import find_problem_gap
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


def test_an_effect_on_the_mean_and_one_on_single_samples_are_both_found_with_increasing_progress(
    monkeypatch, tmp_path
):
    """Half of the samples are searched first. The limit is a quarter of the usual one, as is the rate."""
    monkeypatch.setattr("hubodo.gap.problem.problem._MIN_DECIMATED_RATE_HZ", 25.0)
    problem = read_problem(write_sampled_case(tmp_path, 52.0))
    reports = []
    result = find_problem_gap(problem, report_progress=lambda *report: reports.append(report))
    findings = {(finding.effect, finding.scope): finding for finding in result.found}
    assert set(findings) == {("lever_arm", "left"), ("sample_repeat", "left")}
    probability = findings["sample_repeat", "left"].parameters["probability"]
    assert abs(probability.value - 0.05) < 4.0 * probability.sigma
    assert result.search.used_decimation
    _, shares = zip(*reports, strict=True)
    assert list(shares) == sorted(shares) and shares[0] == 0.0


def test_a_log_at_fifty_hertz_is_not_decimated_and_every_node_keeps_its_channels(problem):
    assert isinstance(problem, Problem) and problem.decimate() is None
    part = problem.select({node.name: slice(0, 50) for node in problem.nodes})
    assert [node.y.shape for node in part.nodes] == [(len(CHANNELS), 50)] * 2
