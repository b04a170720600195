"""The scan of dependences."""

from hubodo.gap.scaffold.scan import scan_dependences


def test_dependences_have_positive_evidence_and_the_best_comes_first(evaluation):
    evidence = [it.evidence for it in scan_dependences(evaluation)]
    assert evidence == sorted(evidence, reverse=True)
    assert all(it > 0.0 for it in evidence)
    assert max(evidence, default=0.0) < 20.0, "nothing is hidden in this log"
