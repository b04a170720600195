"""Terms decomposed into directions, and terms moved along directions."""

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.linear.directions import build_basis, directions_of_terms, move_terms
from hubodo.gap.state.terms import ALL, ModelTerm


def test_a_term_on_all_nodes_moves_the_same_coordinate_of_each(problem):
    term = ModelTerm(BY_NAME["gyro_bias"](), ALL)
    directions, basis = directions_of_terms(problem, [term])
    assert [(direction.node, direction.coordinate) for direction in directions] == [
        (name, k) for name in ("left", "right") for k in range(3)
    ]
    np.testing.assert_array_equal(basis, build_basis(6, [[0, 1, 2], [3, 4, 5]]))


def test_a_step_to_impossible_parameters_is_shortened():
    term = ModelTerm(BY_NAME["gyro_warmup"](x=0.01), "left")
    coordinates = term.effect.coordinates()
    for sign in (1.0, -1.0):
        step = np.zeros(len(coordinates))
        step[-1] = sign * 50.0
        (shifted_term,) = move_terms([term], [step])
        assert shifted_term.effect.is_valid()


def test_a_frozen_coordinate_retains_its_value_exactly():
    term = ModelTerm(BY_NAME["lever_arm"](x=0.15), "left", frozen=(1, 2))
    (shifted,) = move_terms([term], [np.array([1.0, 1e-17, -1e-15])])
    values = shifted.effect.values()
    assert values["x"] != 0.15 and (values["y"], values["z"]) == (0.0, 0.0)
