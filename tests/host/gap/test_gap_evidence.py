"""Evidence and confidence: what they hang on, and what they must not hang on."""

from dataclasses import replace

import numpy as np
import pytest

from gap_matrix import cases, recording
from gap_matrix.world import Motion
from hubodo.effects import BY_NAME
from hubodo.effects.empirical import PREFIX, empirical
from hubodo.gap.judge.posterior import by_name, judged
from hubodo.gap.judge.rival import Rival
from hubodo.gap.judge.search import initial_state
from hubodo.gap.problem.build import build
from hubodo.gap.process_noise.process_noise import process_noise, shared_steps
from hubodo.gap.process_noise.weights import declared_walk
from hubodo.gap.screen.evidence import log_evidence
from hubodo.gap.state.terms import ModelTerm
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

SEED = 31


def rival(name, gain, evidence, scope="left"):
    kind = empirical(name) if name.startswith(PREFIX) else BY_NAME[name]
    return Rival(ModelTerm(kind(), scope), gain, evidence, 0.0)


@pytest.mark.parametrize("count", [1, 3])
def test_two_names_that_fit_alike_are_alike_likely_whatever_their_usual_sizes(count):
    """The same gain by coordinates that are usual in size, a thirtieth, and a thousandth of that."""
    sigmas = 8.0
    made = []
    for size in (1.0, 1.0 / 30.0, 1e-3):
        value = np.full(count, size / np.sqrt(count))
        made.append(log_evidence(0.5 * sigmas**2, value, np.eye(count) * (sigmas / size) ** 2))
    print(made)
    assert np.ptp(made) < 1.0


def test_nothing_is_no_evidence():
    assert log_evidence(2.5, np.array([0.1]), np.array([[500.0]])) < 0.5


def test_structure_without_a_name_counts_where_it_fits_better_and_else_is_the_effect():
    term = f"{PREFIX}gz ~ spin"
    alike, _ = judged([rival("gyro_scale_factor", 100.0, 90.0), rival(term, 100.0, 92.0)])
    better, _ = judged([rival("gyro_scale_factor", 100.0, 90.0), rival(term, 112.0, 104.0)])
    found = [by_name(it, next(one for one in it if one.gain == 100.0)) for it in (alike, better)]
    assert found[0]["gyro_scale_factor"] > 0.99
    assert found[1]["gyro_scale_factor"] < 0.1


def test_both_wheels_are_carried_on_by_the_same_noise_of_a_level_speed(tmp_path):
    """Steps of both angles: the integrated noise of the speed, and that of the yaw rate with either sign."""
    setup = cases.setup(SEED, duration=40.0)
    motion = setup.drive.motion
    level = Motion(0.0 * motion.speed + 3.0, 0.0 * motion.yaw_rate)
    recording.write(replace(setup, drive=replace(setup.drive, motion=level)), [], tmp_path, {})
    problem = build(read_folder(tmp_path), read_model(tmp_path / "model.toml"))
    assert problem.speed_noise == setup.speed_noise
    walks = {node.name: declared_walk(problem, node) for node in problem.nodes}
    wanderings = process_noise(initial_state(problem), walks)
    own = np.diag([0.0 if it.walk.white else it.walk.intensity for it in wanderings])
    together = shared_steps(problem, wanderings)
    wheels = np.flatnonzero(together.any(axis=0))
    found = (own + together)[np.ix_(wheels, wheels)]
    # A level is the mean of its samples: after T seconds a wheel is off by T sigma / (radius sqrt(n)).
    count = 1.0 / cases.REFERENCE_STEP
    each = setup.speed_noise**2 / count / setup.radius**2
    # A tenth is each wheel's own: no two roll quite alike.
    np.testing.assert_allclose(found, each * np.array([[1.0, 0.9], [0.9, 1.0]]), rtol=0.05)
