"""Linearisation: attitudes of body nodes as nuisances, and inversion of singular information matrices."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.linear import linearisation
from hubodo.gap.linear.linearisation import invert_information, linearise


def test_nodes_on_the_body_start_with_the_attitude_that_matches_measured_gravity():
    tilt = 0.3
    reading = np.concatenate([np.zeros(3), 9.81 * np.array([0.0, np.sin(tilt), np.cos(tilt)])])
    nodes = [
        SimpleNamespace(name=name, on_wheel=name == "left", y=np.repeat(reading[:, None], 5, axis=1))
        for name in ("left", "frame")
    ]
    problem = SimpleNamespace(model=SimpleNamespace(effects=[]), nodes=nodes)
    starts = build_initial_state(problem).starts
    assert set(starts) == {"frame"}
    assert starts["frame"].attitude == pytest.approx((tilt, 0.0, 0.0))


def test_attitude_angles_of_body_nodes_are_nuisance_columns(monkeypatch):
    """Two directions and three angles of each of two body nodes: each column is listed for its node."""
    nodes = [SimpleNamespace(name=name, on_wheel=name == "left") for name in ("left", "frame", "seat")]
    directions = [SimpleNamespace(node="left"), SimpleNamespace(node="frame")]
    indices_of_node = {"left": [0], "frame": [1], "seat": []}

    class ZeroSensitivities:
        indices = indices_of_node

        def __init__(self, *_):
            pass

        def columns(self, node, *_):
            return np.zeros((len(indices_of_node[node.name]), 6, 4))

    monkeypatch.setattr(linearisation, "DirectionSensitivities", ZeroSensitivities)
    request = {}

    def innovations(columns, n_columns):
        request.update(size=n_columns, at={name: list(at) for name, at in columns.indices.items()})
        request["shapes"] = {node.name: columns.columns(node, state, {}).shape for node in nodes}
        return SimpleNamespace(grams=None, raw_squares=None, channel_squares=None, log_determinant=0.0)

    problem = SimpleNamespace(nodes=nodes)
    state = SimpleNamespace(
        attitude_columns=lambda node: np.ones((3, 6, 4)), problem=problem, is_memoryless=lambda name: True
    )
    evaluation = SimpleNamespace(state=state, problem=problem, compute_innovations=innovations)
    result = linearise(evaluation, directions)
    assert (request["size"], result.n_nuisances, result.nuisance_indices) == (8, 6, [2, 3, 4, 5, 6, 7])
    assert request["at"] == {"left": [0], "frame": [1, 2, 3, 4], "seat": [5, 6, 7]}
    assert request["shapes"] == {"left": (1, 6, 4), "frame": (4, 6, 4), "seat": (3, 6, 4)}


@given(st.integers(0, 10_000), st.integers(2, 6))
def test_a_regular_information_matrix_is_inverted(seed, size):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((size, 3 * size)) * 10.0 ** rng.uniform(-2, 2, size)[:, None]
    gram = root @ root.T
    np.testing.assert_allclose(invert_information(gram, np.diag(gram)) @ gram, np.eye(size), atol=1e-6)


@given(st.integers(0, 10_000))
def test_a_nearly_dependent_column_is_frozen_and_the_others_are_inverted_without_it(seed):
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((2, 50)) * np.array([[300.0], [200.0]])
    weak = 0.006 * columns[0] + 0.011 * columns[1]
    for order in ([0, 1, 2], [2, 0, 1], [1, 2, 0]):
        stacked = np.stack([*columns, weak])[order]
        gram = stacked @ stacked.T
        covariance = invert_information(gram, np.diag(gram))
        frozen = order.index(2)
        assert not covariance[frozen].any()
        others = [k for k in range(3) if k != frozen]
        np.testing.assert_allclose(
            covariance[np.ix_(others, others)], np.linalg.inv(gram[np.ix_(others, others)]), rtol=1e-6
        )


def test_a_column_reduced_to_rounding_error_is_frozen():
    gram = np.array([[2.0, 0.0], [0.0, 1e-3]])
    assert np.diag(invert_information(gram, np.array([4.0, 1e4]))).tolist() == [0.5, 0.0]
