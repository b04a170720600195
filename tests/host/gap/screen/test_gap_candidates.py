"""Candidates: each effect in each scope."""

import numpy as np

from hubodo.gap.screen.candidates import list_candidates, list_directions
from hubodo.gap.state.terms import ALL, VEHICLE


def test_an_effect_is_a_candidate_on_each_node_and_on_all_nodes_and_a_vehicle_effect_once(evaluation):
    directions = list_directions(evaluation.state)
    candidates = list_candidates(evaluation.problem, directions)
    scopes = [it.term.scope for it in candidates if it.name == "gyro_bias"]
    assert sorted(scopes) == [ALL, "left", "right"]
    assert {it.term.scope for it in candidates if it.name == "track_width"} == {VEHICLE}
    for candidate in candidates:
        assert candidate.basis.shape[0] == len(directions)
        assert np.isin(candidate.basis, (0.0, 1.0)).all() and candidate.basis.any(axis=0).all()
