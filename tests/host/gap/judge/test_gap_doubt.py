"""Doubt about an effect where the noise varies along the drive, with and without others in the model."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from hubodo.effects import BY_NAME
from hubodo.gap.judge.demands import doubtful_gain, is_within_level
from hubodo.gap.judge.round import judge_round
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model
from hubodo.recording import Table

NAME, SCALE_ERROR, TURN = "accel_scale_factor", 0.004, 0.2
GYRO, ACCEL = ("gx", "gy", "gz"), ("ax", "ay", "az")


@pytest.fixture(scope="module", params=[1, 2])
def rough_drive(request, clean_log):
    """Return a drive with a scale error in ax of the left node, and uneven noise in az of the right one."""
    recording, model = read_folder(clean_log), read_model(clean_log / "model.toml")
    left, right = (dict(recording.nodes[name].columns) for name in ("left", "right"))
    is_rough = (right["t"] // 10.0) % 2 == 1
    white = np.random.default_rng(request.param).standard_normal(len(is_rough))
    road = lfilter([1.0], [1.0, -0.9], white) * np.where(is_rough, 2.0, 0.5)
    right["az"] = right["az"] + model.noise.accel * road
    left["ax"] = left["ax"] * (1.0 + SCALE_ERROR)
    return replace(recording, nodes={**recording.nodes, "left": Table(left), "right": Table(right)})


def turn_left_node(recording):
    """Return the drive with the left node turned about y."""
    columns = dict(recording.nodes["left"].columns)
    for axes in (GYRO, ACCEL):
        turned = (
            Rotation.from_rotvec([0.0, TURN, 0.0]).inv().apply(np.stack([columns[a] for a in axes], axis=1))
        )
        columns.update(zip(axes, turned.T, strict=True))
    return replace(recording, nodes={**recording.nodes, "left": Table(columns)})


def judge_scale(recording, model):
    """Return the hypothesis of the scale factor in a round with a model."""
    state, _ = track_wheel_phase(build_initial_state(build_problem(recording, model)))
    judged = judge_round(Evaluation(state, estimate_weights(state)), reject={*BY_NAME, "empirical"} - {NAME})
    return judged.find_hypothesis((NAME, "left"))


def is_within_uneven_noise(hypothesis):
    """Return True if noise whose level varies along the drive could gain as much."""
    gain = replace(hypothesis.held_out_gain, max_doubt=np.inf)
    print(f"held out {gain.total:.0f}, in doubt {doubtful_gain(hypothesis.term, gain):.0f}")
    return is_within_level(hypothesis.term, gain)


def test_uneven_noise_is_no_doubt_of_the_first_effect(rough_drive, clean_log):
    hypothesis = judge_scale(rough_drive, read_model(clean_log / "model.toml"))
    assert is_within_uneven_noise(hypothesis)
    assert not hypothesis.objection


def test_uneven_noise_puts_no_effect_in_doubt_beside_a_large_given_one_that_holds(
    rough_drive, clean_log, tmp_path
):
    path = tmp_path / "model.toml"
    given = f"\n[nodes.left.effects.node_misalignment]\ny = {TURN}\n"
    path.write_text((clean_log / "model.toml").read_text("utf-8") + given, "utf-8")
    hypothesis = judge_scale(turn_left_node(rough_drive), read_model(path))
    assert is_within_uneven_noise(hypothesis)
    assert not hypothesis.objection
