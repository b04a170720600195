"""Linearisation: free attitudes of nodes on the body, and information inverted where there is any."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.linear import linearisation
from hubodo.gap.linear.linearisation import invert_information, linearise


def test_only_nodes_on_the_body_begin_turned_so_that_gravity_is_where_they_feel_it():
    tilt = 0.3
    felt = np.concatenate([np.zeros(3), 9.81 * np.array([0.0, np.sin(tilt), np.cos(tilt)])])
    nodes = [
        SimpleNamespace(name=name, on_wheel=name == "left", y=np.repeat(felt[:, None], 5, axis=1))
        for name in ("left", "frame")
    ]
    problem = SimpleNamespace(model=SimpleNamespace(effects=[]), nodes=nodes)
    starts = build_initial_state(problem).starts
    assert set(starts) == {"frame"}
    assert starts["frame"].attitude == pytest.approx((tilt, 0.0, 0.0))


def test_the_attitude_of_each_is_free_beside_the_directions(monkeypatch):
    """Two directions, three angles of either node on the body: each column with the node that feels it."""
    nodes = [SimpleNamespace(name=name, on_wheel=name == "left") for name in ("left", "frame", "seat")]
    directions = [SimpleNamespace(node="left"), SimpleNamespace(node="frame")]
    felt = {"left": [0], "frame": [1], "seat": []}

    class NoMotion:
        indices = felt

        def __init__(self, *_):
            pass

        def columns(self, node, *_):
            return np.zeros((len(felt[node.name]), 6, 4))

    monkeypatch.setattr(linearisation, "DirectionSensitivities", NoMotion)
    asked = {}

    def innovations(columns, n_columns):
        asked.update(size=n_columns, at={name: list(at) for name, at in columns.indices.items()})
        asked["shapes"] = {node.name: columns.columns(node, state, {}).shape for node in nodes}
        return SimpleNamespace(grams=None, raw_squares=None, log_determinant=0.0)

    problem = SimpleNamespace(nodes=nodes)
    state = SimpleNamespace(
        attitude_columns=lambda node: np.ones((3, 6, 4)), problem=problem, is_memoryless=lambda name: True
    )
    point = SimpleNamespace(state=state, problem=problem, compute_innovations=innovations)
    made = linearise(point, directions)
    assert (asked["size"], made.n_nuisances, made.nuisance_indices) == (8, 6, [2, 3, 4, 5, 6, 7])
    assert asked["at"] == {"left": [0], "frame": [1, 2, 3, 4], "seat": [5, 6, 7]}
    assert asked["shapes"] == {"left": (1, 6, 4), "frame": (4, 6, 4), "seat": (3, 6, 4)}


@given(st.integers(0, 10_000), st.integers(2, 6))
def test_what_is_seen_is_inverted_as_any_matrix_is(seed, size):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((size, 3 * size)) * 10.0 ** rng.uniform(-2, 2, size)[:, None]
    gram = root @ root.T
    np.testing.assert_allclose(invert_information(gram, np.diag(gram)) @ gram, np.eye(size), atol=1e-6)


@given(st.integers(0, 10_000))
def test_what_the_others_do_as_well_is_frozen_and_the_others_known_as_if_it_were_not_there(seed):
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((2, 50)) * np.array([[300.0], [200.0]])
    weak = 0.006 * columns[0] + 0.011 * columns[1]
    for order in ([0, 1, 2], [2, 0, 1], [1, 2, 0]):
        made = np.stack([*columns, weak])[order]
        gram = made @ made.T
        covariance = invert_information(gram, np.diag(gram))
        frozen = order.index(2)
        assert not covariance[frozen].any()
        kept = [k for k in range(3) if k != frozen]
        np.testing.assert_allclose(
            covariance[np.ix_(kept, kept)], np.linalg.inv(gram[np.ix_(kept, kept)]), rtol=1e-6
        )


def test_what_only_rounding_left_of_a_large_column_is_frozen():
    gram = np.array([[2.0, 0.0], [0.0, 1e-3]])
    assert np.diag(invert_information(gram, np.array([4.0, 1e4]))).tolist() == [0.5, 0.0]
