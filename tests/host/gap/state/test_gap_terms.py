"""Terms and their scopes."""

from hubodo.effects import BY_NAME
from hubodo.gap.state.terms import ALL, VEHICLE, ModelTerm, effects_on_node, list_scopes

BIAS = BY_NAME["gyro_bias"]


def test_a_nodes_own_effect_replaces_that_of_all_nodes(problem):
    terms = [ModelTerm(BIAS(x=2.0), "left"), ModelTerm(BIAS(x=1.0), ALL)]
    left, right = (effects_on_node(node, terms)[BIAS].x for node in problem.nodes)
    assert (left, right) == (2.0, 1.0)


def test_scopes_are_the_vehicle_or_all_nodes_and_each(problem):
    assert list_scopes(BIAS, problem.nodes) == [ALL, "left", "right"]
    assert list_scopes(BY_NAME["track_width"], problem.nodes) == [VEHICLE]
    assert list_scopes(BIAS, problem.nodes[:1]) == ["left"]
