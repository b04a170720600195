"""Advice in the summary: record again if held-out data got worse, record longer at low confidence."""

from types import SimpleNamespace

import pytest

from hubodo.gap.explain.result import BeforeAfter, Finding
from hubodo.gap.explain.summary import describe_reduction, list_advice


def build_advice(before, after, confidence):
    """Return the advice for one finding with these held-out gaps and this confidence."""
    finding = Finding(
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
        found=[finding], remaining=[], residual_steps=[{}], model=SimpleNamespace(noise=noise), verdict="gap"
    )
    return " ".join(list_advice(result))


@pytest.mark.parametrize(
    ("before", "after", "repeat_advised"), [(1.3, 1.0, False), (1.2, 1.2, False), (1.1, 1.4, True)]
)
def test_a_finding_that_increases_the_held_out_gap_is_to_be_recorded_again(before, after, repeat_advised):
    text = build_advice(before, after, confidence=0.99)
    assert ("confirm it on another record" in text) == repeat_advised
    assert "gyro_lag" in text and "--reject gyro_lag" in text


@pytest.mark.parametrize(("confidence", "longer_log_advised"), [(0.5, True), (0.99, False)])
def test_a_longer_log_is_advised_at_low_confidence(confidence, longer_log_advised):
    assert ("record longer" in build_advice(1.3, 1.0, confidence)) == longer_log_advised


@pytest.mark.parametrize(
    ("share", "percentage"),
    [(0.5, "50 %"), (0.987, "99 %"), (0.9978, "99.7 %"), (0.9999, "99.9 %"), (1.0, "100 %")],
)
def test_a_reduction_below_100_percent_is_not_rounded_up_to_it(share, percentage):
    """A gap of 3 has the square 9: 1 is noise, 8 is the excess, of which `share` is removed."""
    assert describe_reduction(3.0, (9.0 - share * 8.0) ** 0.5, 1.0).startswith(
        f"{percentage} of what exceeded the noise"
    )


def test_no_percentage_is_given_if_the_gap_was_at_the_noise_floor():
    assert describe_reduction(1.001, 1.0, 1.0) == describe_reduction(1.0, 1.0, None) == ""
