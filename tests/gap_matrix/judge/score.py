"""Scores of one result against the truth, as pure functions."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

SURE = 0.9
EMPIRICAL = "empirical:"
_ANGLES = {"phase"}
_CHANNEL = re.compile(r"(?:\b(left|right)\.)?\b(g[xyz]|a[xyz])\b")
Json = Mapping[str, Any]


def names(result: Json) -> list[str]:
    """Return the names of a result in order, unnamed terms included."""
    return [found["effect"] for found in result["found"]]


def first(result: Json) -> str:
    """Return the first name, `nothing` if there is none."""
    return str((names(result) or ["nothing"])[0])


def named_first(result: Json, truth: Json) -> bool:
    return first(result) == truth["effects"][0]["name"]


def exact(result: Json, truth: Json) -> bool:
    """Return True if all hidden effects are named, in any scope, and nothing else."""
    return set(names(result)) == {effect["name"] for effect in truth["effects"]}


def jaccard(result: Json, truth: Json) -> float:
    """Return names in both over names in either; 1 if both are empty."""
    found, true = set(names(result)), {effect["name"] for effect in truth["effects"]}
    return len(found & true) / len(found | true) if found | true else 1.0


def scope_right(result: Json, truth: Json) -> bool:
    """Return True if the first hidden effect is named first, in its scope."""
    true = truth["effects"][0]
    return named_first(result, truth) and result["found"][0]["scope"] == true["scope"]


def sure_and_wrong(result: Json, truth: Json) -> list[str]:
    """Return the wrong names of the vocabulary with a confidence above SURE.

    Those that have the truth beside them as inseparable are not among them.
    """
    true = {effect["name"] for effect in truth["effects"]}
    return [
        found["effect"]
        for found in result["found"]
        if found["effect"] not in true
        and not found["effect"].startswith(EMPIRICAL)
        and found["confidence"] > SURE
        and not true & set(found["inseparable_from"])
    ]


def in_the_set(result: Json, truth: Json) -> bool:
    """Return True if the truth is named first, or called inseparable from the first name."""
    if not result["found"]:
        return False
    head = result["found"][0]
    return truth["effects"][0]["name"] in (head["effect"], *head["inseparable_from"])


def admits_doubt(result: Json, truth: Json) -> bool:
    """Return True if both of a pair are given, or none with confidence."""
    if not result["found"]:
        return True
    head = result["found"][0]
    given = {head["effect"], *head["inseparable_from"]}
    return {truth["effects"][0]["name"], truth["other"]} <= given or head["confidence"] <= SURE


def deviations(result: Json, truth: Json) -> tuple[list[float], int]:
    """Return errors in reported sigma of the parameters of correct findings, and the number without sigma."""
    made, skipped = [], 0
    for true in truth["effects"]:
        for found in result["found"]:
            if (found["effect"], found["scope"]) != (true["name"], true["scope"]):
                continue
            for key, value in true["parameters"].items():
                given = found["parameters"].get(key)
                if given is None or not given["sigma"]:
                    skipped += 1
                    continue
                error = given["value"] - value
                if key in _ANGLES:
                    error = float(np.angle(np.exp(1j * error)))
                made.append(error / given["sigma"])
    return made, skipped


def closed(gap: Mapping[str, float], oracle: Mapping[str, float], least: float = 1e-4) -> float | None:
    """Return the share of the oracle's reduction of the held-out gap; None if that is below `least`."""
    possible = oracle["before"] - oracle["after"]
    return None if possible < least else (gap["before"] - gap["after"]) / possible


def described(result: Json, truth: Json) -> tuple[bool, bool]:
    """Return whether an unnamed term or `remaining` has the channel, and also one of the words."""
    true = truth["outside"]
    texts = [
        (found["effect"], found["scope"], f"{found['effect']} {found['where']}")
        for found in result["found"]
        if found["effect"].startswith(EMPIRICAL)
    ]
    texts += [(left["channel"], "", f"{left['where']} {left['looks_like']}") for left in result["remaining"]]
    channel = dependence = False
    for place, scope, text in texts:
        nodes = {"all": ("left", "right")}.get(scope, (scope,))
        here = {f"{node or other}.{axis}" for node, axis in _CHANNEL.findall(place) for other in nodes}
        if here & set(true["channels"]):
            channel = True
            dependence |= any(re.search(rf"\b{re.escape(word)}", text.lower()) for word in true["words"])
    return channel, dependence
