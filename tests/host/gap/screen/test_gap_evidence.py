"""Evidence and confidence: what they hang on, and what they must not hang on."""

from dataclasses import replace

import numpy as np
import pytest

from gap_matrix import cases, recording
from gap_matrix.world import Motion
from hubodo.effects import BY_NAME
from hubodo.effects.empirical import PREFIX, empirical
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.judge.posterior import compute_posterior, sum_by_name
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.process_noise import list_process_noise, shared_walk_covariance
from hubodo.gap.process_noise.weights import declared_wheel_walk
from hubodo.gap.screen.evidence import compute_log_evidence
from hubodo.gap.state.terms import ModelTerm
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

SEED = 31


def rival(name, gain, evidence, scope="left"):
    kind = empirical(name) if name.startswith(PREFIX) else BY_NAME[name]
    return Hypothesis(ModelTerm(kind(), scope), gain, evidence, 0.0)


@pytest.mark.parametrize("count", [1, 3])
def test_two_names_that_fit_alike_are_alike_likely_whatever_their_usual_sizes(count):
    """The same gain by coordinates that are usual in size, a thirtieth, and a thousandth of that."""
    sigmas = 8.0
    made = []
    for size in (1.0, 1.0 / 30.0, 1e-3):
        value = np.full(count, size / np.sqrt(count))
        made.append(compute_log_evidence(0.5 * sigmas**2, value, np.eye(count) * (sigmas / size) ** 2))
    print(made)
    assert np.ptp(made) < 1.0


def test_nothing_is_no_evidence():
    assert compute_log_evidence(2.5, np.array([0.1]), np.array([[500.0]])) < 0.5


def test_structure_without_a_name_counts_where_it_fits_better_and_else_is_the_effect():
    term = f"{PREFIX}gz ~ spin"
    alike, _ = compute_posterior([rival("gyro_scale_factor", 100.0, 90.0), rival(term, 100.0, 92.0)])
    better, _ = compute_posterior([rival("gyro_scale_factor", 100.0, 90.0), rival(term, 112.0, 104.0)])
    found = [sum_by_name(it, next(one for one in it if one.gain == 100.0)) for it in (alike, better)]
    assert found[0]["gyro_scale_factor"] > 0.99
    assert found[1]["gyro_scale_factor"] < 0.1


def test_both_wheels_are_carried_on_by_the_same_noise_of_a_level_speed(tmp_path):
    """Steps of both angles: the integrated noise of the speed, and that of the yaw rate with either sign."""
    setup = cases.setup(SEED, duration=40.0)
    motion = setup.drive.motion
    level = Motion(0.0 * motion.speed + 3.0, 0.0 * motion.yaw_rate)
    recording.write(replace(setup, drive=replace(setup.drive, motion=level)), [], tmp_path, {})
    problem = build_problem(read_folder(tmp_path), read_model(tmp_path / "model.toml"))
    assert problem.speed_noise == setup.speed_noise
    walks = {node.name: declared_wheel_walk(problem, node) for node in problem.nodes}
    wanderings = list_process_noise(build_initial_state(problem), walks)
    own = np.diag([0.0 if it.walk.is_white else it.walk.intensity for it in wanderings])
    together = shared_walk_covariance(problem, wanderings)
    wheels = np.flatnonzero(together.any(axis=0))
    found = (own + together)[np.ix_(wheels, wheels)]
    # A level is the mean of its samples: after T seconds a wheel is off by T sigma / (radius sqrt(n)).
    count = 1.0 / cases.REFERENCE_STEP
    each = setup.speed_noise**2 / count / setup.radius**2
    # A tenth is each wheel's own: no two roll quite alike.
    np.testing.assert_allclose(found, each * np.array([[1.0, 0.9], [0.9, 1.0]]), rtol=0.05)
