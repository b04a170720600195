"""What a finding advises: to record again what does not help elsewhere, and longer what is not sure."""

from types import SimpleNamespace

import pytest

from hubodo.gap.explain.result import BeforeAfter, Finding
from hubodo.gap.explain.summary import describe_reduction, list_advice


def advice(before, after, confidence):
    found = Finding(
        effect="gyro_lag",
        scope="left",
        parameters={},
        gap=BeforeAfter(1.3, 1.0),
        held_out_gap=BeforeAfter(before, after),
        p_value=1e-9,
        confidence=confidence,
        where="everywhere",
        runner_up=None,
        inseparable_from=(),
        rivals=(),
    )
    noise = SimpleNamespace(gyro=0.01, accel=0.2)
    result = SimpleNamespace(
        found=[found], remaining=[], residual_steps=[{}], model=SimpleNamespace(noise=noise), verdict="gap"
    )
    return " ".join(list_advice(result))


@pytest.mark.parametrize(
    ("before", "after", "again"), [(1.3, 1.0, False), (1.2, 1.2, False), (1.1, 1.4, True)]
)
def test_what_makes_data_that_was_not_fitted_worse_is_to_be_recorded_again(before, after, again):
    said = advice(before, after, confidence=0.99)
    assert ("record again before you trust it" in said) == again
    assert "gyro_lag" in said and "--reject gyro_lag" in said


@pytest.mark.parametrize(("confidence", "longer"), [(0.5, True), (0.99, False)])
def test_what_is_not_sure_is_to_be_recorded_longer(confidence, longer):
    assert ("record longer" in advice(1.3, 1.0, confidence)) == longer


@pytest.mark.parametrize(
    ("share", "words"),
    [(0.5, "50 %"), (0.987, "99 %"), (0.9978, "99.7 %"), (0.9999, "99.9 %"), (1.0, "100 %")],
)
def test_what_is_not_all_of_it_is_not_called_all_of_it(share, words):
    """Of a gap of 3, three from the noise: what exceeds it is 3^2 - 1."""
    assert describe_reduction(3.0, (9.0 - share * 8.0) ** 0.5, 1.0).startswith(
        f"{words} of what exceeded the noise"
    )


def test_of_what_never_exceeded_the_noise_no_share_is_told():
    assert describe_reduction(1.001, 1.0, 1.0) == describe_reduction(1.0, 1.0, None) == ""
