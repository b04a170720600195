"""The result in sentences, for the terminal and the page: what is missing, how sure that is, what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.explain.descriptions import describe_manoeuvre
from hubodo.gap.explain.result import Estimate, Finding, GapResult
from hubodo.gap.state.terms import ALL, VEHICLE

EMPIRICAL = "empirical:"
_DISPLAY_UNITS: Mapping[str, tuple[float, str]] = {
    "rad": (57.29577951308232, "°"),
    "rad/s": (57.29577951308232, "°/s"),
    "rad/s/°C": (57.29577951308232, "°/s per °C"),
    "1": (100.0, "%"),
    "m": (1e3, "mm"),
    "s": (1e3, "ms"),
    "1e-6": (1.0, "ppm"),
}
_SURE_CONFIDENCE = 0.9
# By so much noise may differ from what is declared before it is worth a line.
_MIN_NOISE_RATIO_FOR_ADVICE = 1.3
_CONFIDENCE_WORDS = (
    (0.999, "practically certain"),
    (0.99, "very sure"),
    (_SURE_CONFIDENCE, "sure"),
    (0.6, "likely"),
)


def describe_verdict(result: GapResult) -> str:
    """The verdict in one sentence."""
    missing = ", and ".join(describe_effect(named) for named in result.found)
    noise = list_noise_advice(result)
    if result.verdict == "no_gap":
        beside = ", though not as large as declared" if noise else ""
        return f"Model and log agree: nothing is missing, what is left is noise{beside}."
    if result.verdict == "explained":
        beside = ", though not as large as declared" if noise else ""
        unknown = any(named.effect.startswith(EMPIRICAL) for named in result.found)
        counted = "taken into account" if unknown else "in the model"
        return f"{_capitalise(missing)}: with that {counted}, only noise is left{beside}."
    if result.verdict == "partly_explained":
        return f"{_capitalise(missing)}; something else is left that no known effect explains."
    return "Model and log disagree, and no known effect explains how."


def describe_effect(finding: Finding) -> str:
    """What one effect means and where it is, such as "the wheel leans (right)"."""
    if finding.effect.startswith(EMPIRICAL):
        return f"a term without a known cause, {finding.effect.removeprefix(EMPIRICAL).strip()}"
    words = BY_NAME[finding.effect].meaning
    place = {ALL: "all nodes", VEHICLE: ""}.get(finding.scope, finding.scope)
    return f"{words} ({place})" if place else words


def describe_confidence(confidence: float) -> str:
    """A probability in words."""
    return next((words for least, words in _CONFIDENCE_WORDS if confidence >= least), "a guess among several")


def describe_reduction(before: float, after: float, floor: float | None) -> str:
    """How much of what exceeded the noise is gone, in words; "" where nothing did."""
    lowest = min(1.0 if floor is None else floor, after)
    excess = before**2 - lowest**2
    if excess <= 1e-6 or before - lowest < 2e-3:
        return ""
    share = (before**2 - after**2) / excess
    return f"{_format_percent(max(share, 0.0))} of what exceeded the noise is explained"


def _format_percent(share: float) -> str:
    # 99.97 % is not all of it.
    return f"{100.0 * share:.0f} %" if share < 0.99 or share >= 1.0 else f"{int(1000.0 * share) / 10.0:.1f} %"


def format_estimate(estimate: Estimate) -> str:
    """A value with its sigma in a unit for people: degrees, per cent, millimetres."""
    factor, unit = _DISPLAY_UNITS.get(estimate.unit, (1.0, estimate.unit))
    if estimate.unit == "s" and abs(estimate.value) > 1.0:
        factor, unit = 1.0, "s"
    sigma = None if estimate.sigma is None else factor * estimate.sigma
    return f"{format_with_sigma(factor * estimate.value, sigma)} {unit}"


def format_with_sigma(value: float, sigma: float | None) -> str:
    """A number with as many digits as its sigma deserves."""
    if sigma is None or not sigma > 0.0:
        return f"{value:.4g}"
    digits = max(0, min(12, 1 - _exponent(sigma)))
    return f"{value:.{digits}f} ± {sigma:.{digits}f}" if digits < 7 else f"{value:.4g} ± {sigma:.2g}"


def _exponent(value: float) -> int:
    return int(f"{abs(value):e}".partition("e")[2])


def list_advice(result: GapResult) -> list[str]:
    """Advice, one sentence each."""
    lines = []
    named = [it for it in result.found if not it.effect.startswith(EMPIRICAL)]
    for it in result.found:
        if it not in named:
            lines.append(
                f"{it.effect.removeprefix(EMPIRICAL).strip()} is what no known effect makes: look for its "
                "cause there; model.toml does not have it. --reject empirical shows what comes nearest."
            )
    if named:
        names = ", ".join(dict.fromkeys(it.effect for it in named))
        lines.append(f"Use the model that was written beside this page from now on: it has {names}.")
    for it in result.found:
        if it.inseparable_from:
            lines.append(
                f"{it.effect} could also be {' or '.join(it.inseparable_from)}: "
                f"{describe_manoeuvre(it.effect, it.inseparable_from)}."
            )
        elif it.confidence < _SURE_CONFIDENCE:
            lines.append(f"{it.effect} is not sure: record longer, with more changes of speed and turns.")
        if it.held_out_gap.after > it.held_out_gap.before + 1e-3:
            lines.append(
                f"{it.effect} does not help on data that was not fitted: record again before you trust it."
            )
    if named:
        lines.append(
            f"If you know better, run again with --reject {named[0].effect}; "
            f"--explain NAME says why an effect was not chosen."
        )
    lines += list_noise_advice(result)
    channels = list(dict.fromkeys(left.channel for left in result.remaining))
    if channels:
        where = join_words(channels) if len(channels) <= 4 else f"{len(channels)} channels"
        lines.append(f"Look at what remains in {where}.")
    if not result.found and not lines:
        lines.append("Keep the model. A longer or livelier drive would show smaller effects.")
    return lines


def list_noise_advice(result: GapResult) -> list[str]:
    """Where the noise of a triad is clearly not what the model file declares, with the estimate."""
    lines = []
    noise = result.model.noise
    triads = (
        ("gyro_noise", slice(0, 3), noise.gyro, "rad/s"),
        ("accel_noise", slice(3, 6), noise.accel, "m/s²"),
    )
    for key, rows, declared, unit in triads:
        ratios = []
        for residual in result.residual_steps[-1].values():
            kept = residual.node.used[rows]
            beside = residual.noise.sigma[rows] / residual.declared_sigma[rows]
            ratios += list(np.sqrt(np.mean(beside[kept] ** 2, axis=1)))
        ratio = float(np.median(ratios)) if ratios else 1.0
        if not 1.0 / _MIN_NOISE_RATIO_FOR_ADVICE < ratio < _MIN_NOISE_RATIO_FOR_ADVICE:
            size = "larger" if ratio > 1.0 else "smaller"
            lines.append(
                f"The noise is {size} than [imu] {key} = {declared:.3g} says: about {ratio * declared:.2g} "
                f"{unit} fits the samples; correct it, the gap is measured with it."
            )
    return lines


def describe_runner_up(finding: Finding) -> str:
    """The name that came second."""
    if finding.runner_up is None:
        return "nothing else came near"
    other, share = finding.runner_up
    return f"next best: {other}, {format_probability(share)}"


def format_probability(value: float) -> str:
    """A probability; small ones keep their exponent."""
    if value >= 0.995:
        return "> 99.9 %" if value >= 0.9995 else f"{100.0 * value:.1f} %"
    return f"{100.0 * value:.1f} %" if value >= 0.001 else f"{value:.0e}" if value > 0.0 else "< 1e-300"


def list_model_comments(result: GapResult, log_name: str) -> dict[tuple[str, str | None], str]:
    """What `model.toml` says above each effect that was added."""
    made = {}
    for named in result.found:
        if named.effect.startswith(EMPIRICAL):
            continue
        node = None if named.scope in (ALL, VEHICLE) else named.scope
        values = ", ".join(
            f"{name} {format_with_sigma(it.value, it.sigma)} {it.unit if it.unit != '1' else ''}".rstrip()
            for name, it in named.parameters.items()
        )
        confidence = format_probability(named.confidence)
        text = f"Added by hubodo gap from {log_name}: {values}; confidence {confidence}."
        if named.inseparable_from:
            text += f" Could also be {', '.join(named.inseparable_from)}."
        made[named.effect, node] = f"{text}\n{named.where}"
    return made


def _capitalise(text: str) -> str:
    return text[:1].upper() + text[1:]


def join_words(words: Sequence[str]) -> str:
    """ "a, b and c"."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""
