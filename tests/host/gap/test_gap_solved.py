"""Information inverted where there is any: what nothing tells apart is frozen, and nothing else with it."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hubodo.gap.linear.linearisation import invert_information


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
