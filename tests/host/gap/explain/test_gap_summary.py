"""Advice in the summary: record again if held-out data got worse, record longer at low confidence."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from hubodo.gap.explain.result import BeforeAfter, Estimate, Finding, split_by_channel
from hubodo.gap.explain.summary import (
    describe_reduction,
    describe_runner_up,
    format_parameters,
    list_advice,
)
from hubodo.gap.explain.unnamed import merge_channels


def build_finding(before, after, confidence=0.99, effect="gyro_lag", scope="left", **fields):
    """Return a finding with these held-out gaps and this confidence."""
    finding = Finding(
        effect=effect,
        scope=scope,
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
    return replace(finding, **fields)


def build_advice(*findings, refined=()):
    """Return the advice for findings in order; `refined`: given effects whose values differ a little."""
    held_out = BeforeAfter(1.1, 1.1)
    if findings:
        held_out = BeforeAfter(findings[0].held_out_gap.before, findings[-1].held_out_gap.after)
    result = SimpleNamespace(
        found=findings,
        refined=refined,
        held_out_gap=held_out,
        remaining=[],
        residual_steps=[{}],
        model=SimpleNamespace(noise=SimpleNamespace(gyro=0.01, accel=0.2)),
        verdict="gap",
    )
    return " ".join(list_advice(result))


@pytest.mark.parametrize(
    ("before", "after", "repeat_advised"), [(1.3, 1.0, False), (1.2, 1.2, False), (1.1, 1.4, True)]
)
def test_a_finding_that_increases_the_held_out_gap_is_to_be_recorded_again(before, after, repeat_advised):
    text = build_advice(build_finding(before, after))
    assert ("confirm it on another record" in text) == ("Do not use model.toml" in text) == repeat_advised
    assert "gyro_lag" in text and "--reject gyro_lag" in text


def test_a_model_that_explains_held_out_data_is_usable_though_one_of_its_effects_does_not_help():
    lever_arm = build_finding(7.4, 1.2, effect="lever_arm", scope="all")
    text = build_advice(lever_arm, build_finding(1.2, 1.3, effect="gyro_bias", scope="right"))
    assert "Use the written model.toml" in text and "Do not use" not in text
    assert "1.300 (7.400 before), without help of gyro_bias (right)." in text


def test_given_effects_that_differ_as_drives_do_are_named_though_they_are_no_findings():
    text = build_advice(refined=[build_finding(1.2, 1.1, effect="gyro_bias", scope="right")])
    assert text.startswith("gyro_bias (right) differs from the given model by no more than one drive")


def test_the_same_advice_for_two_nodes_is_given_once():
    fields = {"effect": "node_misalignment", "inseparable_from": ("gyro_nonorthogonality",)}
    text = build_advice(build_finding(3.0, 2.0, **fields), build_finding(2.0, 1.0, scope="right", **fields))
    assert text.count("could also be") == 1
    assert text.startswith("node_misalignment (left, right) could also be gyro_nonorthogonality: ")


def test_an_unnamed_term_on_several_channels_is_described_once_with_its_strongest_amplitudes():
    amplitudes = {
        f"{axis}_cos{k}": Estimate(1e-5, 1e-6 * k, "rad/s") for axis in ("gx", "gy") for k in (1, 2)
    }
    term = build_finding(1.2, 1.1, effect="empirical:gx,gy ~ spin^2*harmonics(theta)", parameters=amplitudes)
    channels = split_by_channel(term)
    (merged,) = merge_channels(channels)
    assert len(channels) == 2 and merged.effect == "empirical:left.gx, left.gy ~ spin^2*harmonics(theta)"
    lines = format_parameters(merged)
    assert [line.split(" 1e-05")[0] for line in lines[:2]] == ["gx cos1", "gy cos1"]
    assert len(lines) == 4 and lines[-1] == "1 further amplitudes: see gap.json"
    text = build_advice(*channels)
    # The written model has the term.
    assert text.count("No known effect explains left.gx, left.gy ~ spin^2*harmonics(theta)") == 1
    assert "not in model.toml" not in text and "model.toml has it as a formula" in text


@pytest.mark.parametrize(
    ("inseparable", "share", "words"),
    [(("lever_arm",), 0.003, "fits as well"), (("lever_arm",), 0.3, "30.0 %"), ((), 0.003, "0.3 %")],
)
def test_a_runner_up_that_fits_as_well_has_no_negligible_probability(inseparable, share, words):
    runner_up = ("lever_arm", share)
    finding = build_finding(1.3, 1.0, 0.571, inseparable_from=inseparable, runner_up=runner_up)
    assert describe_runner_up(finding).endswith(words)


@pytest.mark.parametrize(("confidence", "longer_log_advised"), [(0.5, True), (0.99, False)])
def test_a_longer_log_is_advised_at_low_confidence(confidence, longer_log_advised):
    assert ("record longer" in build_advice(build_finding(1.3, 1.0, confidence))) == longer_log_advised


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
    # Noise that is correlated from sample to sample leaves less than its scatter suggests.
    assert describe_reduction(1.70, 1.69, 1.77) == ""
    assert describe_reduction(1.001, 1.0, 1.0) == describe_reduction(1.0, 1.0, None) == ""
