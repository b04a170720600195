"""Construction of a gap problem: its nodes and its time span."""

from hubodo.gap.problem.build import MIN_DURATION


def test_a_problem_has_all_nodes_and_the_time_common_to_nodes_and_inputs(problem):
    assert [node.name for node in problem.nodes] == ["left", "right"]
    assert all(node.used.all() and node.on_wheel for node in problem.nodes)
    assert MIN_DURATION < problem.duration <= 60.0
