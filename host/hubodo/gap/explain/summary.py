"""Sentences about a result for terminal and page: what is missing, how certain that is, what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.explain.descriptions import describe_manoeuvre, list_alternatives
from hubodo.gap.explain.result import Estimate, Finding
from hubodo.gap.explain.unnamed import describe_term, is_unnamed, merge_channels, select_amplitudes
from hubodo.gap.state.terms import ALL, VEHICLE

if TYPE_CHECKING:
    from hubodo.gap.explain.missing_effects import MissingEffects

_DISPLAY_UNITS: Mapping[str, tuple[float, str]] = {
    "rad": (57.29577951308232, "°"),
    "rad/s": (57.29577951308232, "°/s"),
    "rad/s/°C": (57.29577951308232, "°/s per °C"),
    "1": (100.0, "%"),
    "m": (1e3, "mm"),
    "s": (1e3, "ms"),
    "1e-6": (1.0, "ppm"),
}
# Factor and unit of an angle or its rate, given in addition to the SI value.
_ANGLE_UNITS = {unit: _DISPLAY_UNITS[unit] for unit in ("rad", "rad/s", "rad/s/°C")}
_SURE_CONFIDENCE = 0.9
# Largest growth of the held-out gap that is ignored.
_MAX_HELD_OUT_GROWTH = 1e-3
# Ratio of estimated to declared noise, or its inverse, from which on advice is given.
_MIN_NOISE_RATIO_FOR_ADVICE = 1.3
# Probability below which the number would hide that the runner-up fits as well.
_MIN_RUNNER_UP_PROBABILITY = 0.05
_CONFIDENCE_WORDS = (
    (0.999, "almost certain"),
    (0.99, "very sure"),
    (_SURE_CONFIDENCE, "sure"),
    (0.6, "likely"),
)


def describe_verdict(result: MissingEffects) -> str:
    """Return the verdict as one sentence."""
    missing = join_words([describe_effect(finding) for finding in merge_channels(result.found)])
    noise = list_noise_advice(result)
    if result.verdict == "no_gap":
        noise_remark = ", though not as large as declared" if noise else ""
        return f"Model and log agree: nothing is missing, the residual is noise{noise_remark}."
    if result.verdict == "explained":
        noise_remark = ", though not as large as declared" if noise else ""
        has_unnamed = any(is_unnamed(finding) for finding in result.found)
        remedy = "taken into account" if has_unnamed else "in the model"
        return f"{_capitalise(missing)}: with that {remedy}, the residual is noise{noise_remark}."
    if result.verdict == "partly_explained":
        return f"{_capitalise(missing)}; part of the residual is not explained by any known effect."
    return "Model and log disagree, and no known effect explains it."


def describe_effect(finding: Finding) -> str:
    """Return the meaning of an effect and its place, such as "the wheel leans (right)"."""
    if is_unnamed(finding):
        return f"an unnamed term ({describe_term(finding)})"
    words = BY_NAME[finding.effect].meaning
    place = {ALL: "all nodes", VEHICLE: ""}.get(finding.scope, finding.scope)
    return f"{words} ({place})" if place else words


def describe_confidence(confidence: float) -> str:
    """Return a probability in words."""
    return next((words for least, words in _CONFIDENCE_WORDS if confidence >= least), "a guess among several")


def describe_reduction(before: float, after: float, floor: float | None) -> str:
    """Return the explained share of the excess over noise, in words; "" if there was no excess."""
    if floor is not None and before <= floor:
        return ""
    lowest = min(1.0 if floor is None else floor, after)
    excess = before**2 - lowest**2
    if excess <= 1e-6 or before - lowest < 2e-3:
        return ""
    share = (before**2 - after**2) / excess
    return f"{_format_percent(max(share, 0.0))} of what exceeded the noise is explained"


def _format_percent(share: float) -> str:
    # 99.97 % must not be rounded to 100 %.
    return f"{100.0 * share:.0f} %" if share < 0.99 or share >= 1.0 else f"{int(1000.0 * share) / 10.0:.1f} %"


def format_estimate(estimate: Estimate) -> str:
    """Return a value with its sigma in a common unit: degrees, per cent, millimetres."""
    factor, unit = _DISPLAY_UNITS.get(estimate.unit, (1.0, estimate.unit))
    if estimate.unit == "s" and abs(estimate.value) > 1.0:
        factor, unit = 1.0, "s"
    sigma = None if estimate.sigma is None else factor * estimate.sigma
    return f"{format_with_sigma(factor * estimate.value, sigma)} {unit}"


def format_parameter(name: str, estimate: Estimate) -> str:
    """Return name and value of a parameter in its SI unit, angles also in degrees."""
    text = format_with_sigma(estimate.value, estimate.sigma)
    unit = "" if estimate.unit == "1" else estimate.unit
    angle = f"({format_angle(estimate)})" if estimate.unit in _ANGLE_UNITS else ""
    return " ".join(part for part in (name, text, unit, angle) if part)


def format_parameters(finding: Finding) -> list[str]:
    """Return the parameters of a finding as `format_parameter` does; of an unnamed term the strongest."""
    shown, n_others = select_amplitudes(finding)
    more = [f"{n_others} further amplitudes: see gap.json"] if n_others else []
    return [*(format_parameter(name, estimate) for name, estimate in shown.items()), *more]


def format_angle(estimate: Estimate) -> str:
    """Return an angle, or its rate, in degrees; "" for another quantity."""
    factor, unit = _ANGLE_UNITS.get(estimate.unit, (1.0, ""))
    if not unit:
        return ""
    sigma = None if estimate.sigma is None else factor * estimate.sigma
    return f"{format_with_sigma(factor * estimate.value, sigma).partition(' ±')[0]}{unit}"


def format_with_sigma(value: float, sigma: float | None) -> str:
    """Return a number with as many digits as its sigma justifies."""
    if sigma is None or not sigma > 0.0:
        return f"{value:.4g}"
    digits = max(0, min(12, 1 - _exponent(sigma)))
    return f"{value:.{digits}f} ± {sigma:.{digits}f}" if digits < 7 else f"{value:.4g} ± {sigma:.2g}"


def _exponent(value: float) -> int:
    return int(f"{abs(value):e}".partition("e")[2])


def list_advice(result: MissingEffects) -> list[str]:
    """Return advice, one sentence each: what to measure next, then what to do with the model."""
    listed = [finding for finding in result.found if not is_unnamed(finding)]
    lines = _advise_measurements(result)
    lines += [
        f"No known effect explains {describe_term(finding)}: model.toml has it as a formula without a name. "
        "Look for its cause; --reject empirical shows the nearest known effect."
        for finding in merge_channels(result.found)
        if is_unnamed(finding)
    ]
    if listed:
        lines += [_advise_model(result, listed)]
        lines.append(
            f"If you know better, run again with --reject {listed[0].effect}; "
            f"--explain NAME shows why an effect was not chosen."
        )
    if result.refined:
        labels = join_words([_label_effect(finding.effect, [finding.scope]) for finding in result.refined])
        differs = "differs" if len(result.refined) == 1 else "differ"
        lines.append(
            f"{labels} {differs} from the given model by no more than one drive from the next; "
            "model.toml has the values of this one."
        )
    lines += list_noise_advice(result)
    if not result.found and not lines:
        lines.append("Keep the model. A longer or livelier drive would show smaller effects.")
    return lines


def _advise_measurements(result: MissingEffects) -> list[str]:
    """Return what to measure next, one sentence each; the same advice for several scopes is given once."""
    scopes = dict[tuple[str, str], list[str]]()
    for finding in merge_channels(result.found):
        for words in _list_doubts(finding):
            scopes.setdefault((finding.effect, words), []).append(finding.scope)
    lines = [f"{_label_effect(effect, places)} {words}." for (effect, words), places in scopes.items()]
    channels = list(dict.fromkeys(item.channel for item in result.remaining))
    if channels:
        place = join_words(channels) if len(channels) <= 4 else f"{len(channels)} channels"
        lines.append(f"Inspect the residual of {place}.")
    return lines


def _list_doubts(finding: Finding) -> list[str]:
    """Return what is uncertain about a finding and how to resolve it, each as the rest of a sentence."""
    doubts = []
    if finding.inseparable_from:
        manoeuvre = describe_manoeuvre(finding.effect, finding.inseparable_from)
        doubts.append(
            f"could also be {' or '.join(list_alternatives(finding.inseparable_from))}: {manoeuvre}"
        )
    elif finding.confidence < _SURE_CONFIDENCE:
        doubts.append("is uncertain: record longer, with more turns and changes of speed")
    if not improves_held_out(finding):
        doubts.append("does not reduce the gap on held-out data: confirm it on another record")
    return doubts


def _label_effect(effect: str, scopes: Sequence[str]) -> str:
    """Return a name with its places, such as `gyro_bias (left, right)`."""
    places = ["all nodes" if scope == ALL else scope for scope in scopes if scope != VEHICLE]
    return f"{effect} ({', '.join(places)})" if places else effect


def improves_held_out(finding: Finding) -> bool:
    """Return True if the gap on held-out data does not grow with an effect."""
    return not finding.held_out_gap.after > finding.held_out_gap.before + _MAX_HELD_OUT_GROWTH


def _advise_model(result: MissingEffects, listed: Sequence[Finding]) -> str:
    """Return advice for or against the written model, depending on held-out data."""
    doubtful = [finding for finding in listed if not improves_held_out(finding)]
    before, after = result.held_out_gap.before, result.held_out_gap.after
    if after > before + _MAX_HELD_OUT_GROWTH:
        names = [finding.effect for finding in doubtful or listed]
        rejected = " ".join(f"--reject {name}" for name in dict.fromkeys(names))
        return (
            f"Do not use model.toml as it is: on held-out data its gap is larger, {after:.3f} instead of "
            f"{before:.3f}. Run again with {rejected}."
        )
    names = list(dict.fromkeys(finding.effect for finding in listed))
    of_drive = list(dict.fromkeys(finding.effect for finding in listed if finding.belongs_to_drive))
    remark = ""
    if doubtful:
        labels = join_words([_label_effect(finding.effect, [finding.scope]) for finding in doubtful])
        remark = f" Its gap on held-out data is {after:.3f} ({before:.3f} before), without help of {labels}."
    if of_drive:
        belongs = "belongs" if len(of_drive) == 1 else "belong"
        remark += (
            f" {join_words(of_drive)} {belongs} to this drive and will be estimated again on the next one."
        )
    return f"Use the written model.toml on the next drive: it contains {join_words(names)}.{remark}"


def list_noise_advice(result: MissingEffects) -> list[str]:
    """Return advice where the noise of a triad clearly differs from its declaration, with the estimate."""
    lines = []
    noise = result.model.noise
    triads = (
        ("gyro_noise", slice(0, 3), noise.gyro, "rad/s"),
        ("accel_noise", slice(3, 6), noise.accel, "m/s²"),
    )
    for key, rows, declared, unit in triads:
        ratios = []
        for residual in result.residual_steps[-1].values():
            is_used = residual.node.used[rows]
            relative = residual.noise.sigma[rows] / residual.declared_sigma[rows]
            ratios += list(np.sqrt(np.mean(relative[is_used] ** 2, axis=1)))
        ratio = float(np.median(ratios)) if ratios else 1.0
        if not 1.0 / _MIN_NOISE_RATIO_FOR_ADVICE < ratio < _MIN_NOISE_RATIO_FOR_ADVICE:
            size = "larger" if ratio > 1.0 else "smaller"
            lines.append(
                f"The noise is {size} than [imu] {key} = {declared:.3g} says: about {ratio * declared:.2g} "
                f"{unit} fits the samples; correct it, the gap is measured with it."
            )
    return lines


def describe_runner_up(finding: Finding) -> str:
    """Return the second most probable effect, in words."""
    if finding.runner_up is None:
        return "no other effect comes near"
    other, share = finding.runner_up
    if other in finding.inseparable_from and share < min(
        _MIN_RUNNER_UP_PROBABILITY, 1.0 - finding.confidence
    ):
        # It lost for its larger number of parameters, or on held-out samples.
        return f"runner-up: {other}, which fits as well"
    return f"runner-up: {other}, probability {format_probability(share)}"


def format_probability(value: float) -> str:
    """Return a probability in per cent; beyond 0.05 % from either end a bound."""
    if value >= 0.995:
        return "> 99.9 %" if value >= 0.9995 else f"{100.0 * value:.1f} %"
    return f"{100.0 * value:.1f} %" if value >= 0.0005 else "< 0.1 %"


def list_model_comments(result: MissingEffects, log_name: str) -> dict[tuple[str, str | None], str]:
    """Return the comment above each added effect in `model.toml`."""
    comments = {}
    for finding in result.found:
        if is_unnamed(finding):
            continue
        node = None if finding.scope in (ALL, VEHICLE) else finding.scope
        values = ", ".join(format_parameter(name, one) for name, one in finding.parameters.items())
        confidence = format_probability(finding.confidence)
        text = f"Added by hubodo gap from {log_name}: {values}; confidence {confidence}."
        if finding.inseparable_from:
            text += f" Could also be {', '.join(list_alternatives(finding.inseparable_from))}."
        comments[finding.effect, node] = f"{text}\n{finding.where}"
    return comments


def _capitalise(text: str) -> str:
    return text[:1].upper() + text[1:]


def join_words(words: Sequence[str]) -> str:
    """Return "a, b and c"."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""
