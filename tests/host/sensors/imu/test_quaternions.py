"""Quaternion products along turns, against scipy's rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hubodo.sensors.imu.quaternions import (
    chain_product,
    chain_products_after,
    cross,
    inverse_matrices,
    quaternions_from_vectors,
    rotate_inverse,
)

RNG = np.random.default_rng(8)


def rotation(quaternion):
    return Rotation.from_quat(np.roll(quaternion, -1))


@pytest.mark.parametrize("length", [1, 2, 5, 8])
def test_products_along_a_turn_are_those_of_scipy(length):
    vectors = RNG.normal(0.0, 0.7, (3, length, 3))
    q = quaternions_from_vectors(vectors)
    total, after = chain_products_after(q)
    for turn in range(3):
        steps = [Rotation.from_rotvec(vector) for vector in vectors[turn]]
        product = Rotation.identity()
        for k in range(length - 1, -1, -1):
            assert (rotation(after[:, turn, k]).inv() * product).magnitude() == pytest.approx(0.0, abs=1e-7)
            product = steps[k] * product
        assert (rotation(total[:, turn]).inv() * product).magnitude() == pytest.approx(0.0, abs=1e-7)
    assert chain_product(q) == pytest.approx(total)


def test_inverse_rotations_of_vectors_and_matrices_agree_with_scipy():
    vectors, fixed = RNG.normal(size=(6, 3)), RNG.normal(size=(6, 3))
    q = quaternions_from_vectors(vectors)
    expected = Rotation.from_rotvec(vectors).inv()
    assert rotate_inverse(q.T, fixed) == pytest.approx(expected.apply(fixed))
    assert inverse_matrices(q) == pytest.approx(expected.as_matrix())
    assert cross(vectors, fixed) == pytest.approx(np.cross(vectors, fixed))
