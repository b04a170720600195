"""A stack of symmetric matrices stored as triangles, against the full matrices."""

import numpy as np

from hubodo.gap.process_noise.symmetric import SymmetricStack


def test_a_stack_of_triangles_computes_like_full_matrices():
    rng = np.random.default_rng(4)
    full = rng.standard_normal((70, 5, 5))
    full = full + full.transpose(0, 2, 1)
    stack = SymmetricStack.allocate(70, 5)
    stack.store(0, full[:30])
    stack.store(30, full[30:])
    vector, columns = rng.standard_normal(5), [3, 0, 4]
    assert len(stack) == 70
    np.testing.assert_array_equal(stack.unpack(), full)
    np.testing.assert_allclose(stack.sum(), full.sum(axis=0))
    np.testing.assert_allclose(stack.multiply(vector), full @ vector)
    np.testing.assert_array_equal(stack.select(columns).unpack(), full[:, columns][:, :, columns])
