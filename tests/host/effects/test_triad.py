"""Matrices of sensor triads: the layout of Avrutov's six angles, and products that do not depend on N."""

import numpy as np

from hubodo.effects.gyro import GyroNonorthogonality, GyroScaleFactor
from hubodo.effects.triad import multiply


def test_cross_axis_angles_have_their_places_and_signs():
    angles = GyroNonorthogonality(xz=1.0, xy=2.0, yz=3.0, yx=4.0, zy=5.0, zx=6.0)
    matrix = [[0.0, 1.0, -2.0], [-3.0, 0.0, 4.0], [5.0, -6.0, 0.0]]
    np.testing.assert_array_equal(angles.matrix(), matrix)
    assert GyroNonorthogonality.of_matrix(np.array(matrix) + np.eye(3)) == angles


def test_scale_errors_are_on_the_diagonal():
    np.testing.assert_array_equal(GyroScaleFactor(0.1, 0.2, 0.3).matrix(), np.diag([0.1, 0.2, 0.3]))


def test_products_are_those_of_matrices_with_the_same_bits_for_any_count():
    rng = np.random.default_rng(1)
    matrix, vectors = rng.normal(size=(3, 3)), rng.normal(size=(3, 1000))
    product = multiply(matrix, vectors)
    np.testing.assert_allclose(product, matrix @ vectors, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(product[:, 17:18], multiply(matrix, vectors[:, 17:18]))
