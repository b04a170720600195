"""Scores of one result against the truth, as pure functions."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

CONFIDENCE_THRESHOLD = 0.9
EMPIRICAL = "empirical:"
_ANGULAR_PARAMETERS = {"phase"}
_CHANNEL = re.compile(r"(?:\b(left|right)\.)?\b(g[xyz]|a[xyz])\b")
Json = Mapping[str, Any]


def effect_names(result: Json) -> list[str]:
    """Return the names of a result in order, empirical terms included."""
    return [finding["effect"] for finding in result["found"]]


def first_name(result: Json) -> str:
    """Return the first name, or `nothing`."""
    return str((effect_names(result) or ["nothing"])[0])


def is_named_first(result: Json, truth: Json) -> bool:
    """Return True if the first name is that of the first hidden effect."""
    return first_name(result) == truth["effects"][0]["name"]


def is_exact(result: Json, truth: Json) -> bool:
    """Return True if all hidden effects are named, in any scope, and nothing else."""
    return set(effect_names(result)) == {effect["name"] for effect in truth["effects"]}


def jaccard(result: Json, truth: Json) -> float:
    """Return the Jaccard index of found and hidden names: intersection over union; 1 if both are empty."""
    names, hidden = set(effect_names(result)), {effect["name"] for effect in truth["effects"]}
    return len(names & hidden) / len(names | hidden) if names | hidden else 1.0


def is_scope_correct(result: Json, truth: Json) -> bool:
    """Return True if the first hidden effect is named first, in its scope."""
    true_effect = truth["effects"][0]
    return is_named_first(result, truth) and result["found"][0]["scope"] == true_effect["scope"]


def confident_wrong_names(result: Json, truth: Json) -> list[str]:
    """Return the wrong names of the vocabulary with a confidence above CONFIDENCE_THRESHOLD.

    A wrong name that is stated as inseparable from a hidden effect is not counted.
    """
    hidden = {effect["name"] for effect in truth["effects"]}
    return [
        finding["effect"]
        for finding in result["found"]
        if finding["effect"] not in hidden
        and not finding["effect"].startswith(EMPIRICAL)
        and finding["confidence"] > CONFIDENCE_THRESHOLD
        and not hidden & set(finding["inseparable_from"])
    ]


def is_in_candidate_set(result: Json, truth: Json) -> bool:
    """Return True if the hidden effect is named first, or stated as inseparable from the first name."""
    if not result["found"]:
        return False
    first = result["found"][0]
    return truth["effects"][0]["name"] in (first["effect"], *first["inseparable_from"])


def admits_ambiguity(result: Json, truth: Json) -> bool:
    """Return True if both effects of a confusable pair are given, or none with confidence."""
    if not result["found"]:
        return True
    first = result["found"][0]
    names = {first["effect"], *first["inseparable_from"]}
    return {truth["effects"][0]["name"], truth["other"]} <= names or first[
        "confidence"
    ] <= CONFIDENCE_THRESHOLD


def parameter_errors(result: Json, truth: Json) -> tuple[list[float], int]:
    """Return parameter errors of correct findings in units of their sigma, and the number without a sigma."""
    errors, skipped = [], 0
    for true_effect in truth["effects"]:
        for finding in result["found"]:
            if (finding["effect"], finding["scope"]) != (true_effect["name"], true_effect["scope"]):
                continue
            for key, value in true_effect["parameters"].items():
                estimate = finding["parameters"].get(key)
                if estimate is None or not estimate["sigma"]:
                    skipped += 1
                    continue
                error = estimate["value"] - value
                if key in _ANGULAR_PARAMETERS:
                    error = float(np.angle(np.exp(1j * error)))
                errors.append(error / estimate["sigma"])
    return errors, skipped


def gap_closure(
    gap: Mapping[str, float], oracle: Mapping[str, float], min_reduction: float = 1e-4
) -> float | None:
    """Return the reduction of the held-out gap relative to that by the true effect alone (the oracle).

    None if the oracle reduces the gap by less than `min_reduction`.
    """
    possible_reduction = oracle["before"] - oracle["after"]
    return None if possible_reduction < min_reduction else (gap["before"] - gap["after"]) / possible_reduction


def matches_description(result: Json, truth: Json) -> tuple[bool, bool]:
    """Return whether a term or residual names a correct channel, and whether it has an expected word, too."""
    hidden = truth["outside"]
    texts = [
        (finding["effect"], finding["scope"], f"{finding['effect']} {finding['where']}")
        for finding in result["found"]
        if finding["effect"].startswith(EMPIRICAL)
    ]
    texts += [
        (residual["channel"], "", f"{residual['where']} {residual['looks_like']}")
        for residual in result["remaining"]
    ]
    channel_matches = dependence_matches = False
    for name, scope, text in texts:
        nodes = {"all": ("left", "right")}.get(scope, (scope,))
        channels = {f"{node or other}.{axis}" for node, axis in _CHANNEL.findall(name) for other in nodes}
        if channels & set(hidden["channels"]):
            channel_matches = True
            dependence_matches |= any(
                re.search(rf"\b{re.escape(word)}", text.lower()) for word in hidden["words"]
            )
    return channel_matches, dependence_matches
