"""The scan for dependences of residuals on the motion."""

from hubodo.gap.scaffold.scan import scan_dependences


def test_dependences_have_positive_evidence_and_the_best_comes_first(evaluation):
    evidence = [dependence.evidence for dependence in scan_dependences(evaluation)]
    assert evidence == sorted(evidence, reverse=True)
    assert min(evidence, default=1.0) > 0.0
    assert max(evidence, default=0.0) < 20.0, "this log has no hidden effect"
