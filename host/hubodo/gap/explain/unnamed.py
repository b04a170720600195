"""Unnamed terms as people read them: one finding for all of its channels, with the strongest amplitudes.

`gap.json` has one entry for each channel, with all amplitudes. Six harmonics on six channels are 72 of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np

from hubodo.effects.empirical import PREFIX
from hubodo.gap.explain.result import Estimate, Finding

# Amplitudes of an unnamed term that are shown.
_MAX_AMPLITUDES = 3


def is_unnamed(finding: Finding) -> bool:
    """Return True for a term without a name."""
    return finding.effect.startswith(PREFIX)


def describe_term(finding: Finding) -> str:
    """Return channels and expression of an unnamed term."""
    return finding.effect.removeprefix(PREFIX).strip()


def merge_channels(findings: Sequence[Finding]) -> list[Finding]:
    """Return findings in which the channels of one unnamed term are one; the others as they are."""
    merged = []
    for _key, group in groupby(findings, key=_identify_term):
        members = list(group)
        merged.append(members[0] if len(members) == 1 else _merge(members))
    return merged


def _identify_term(finding: Finding) -> tuple[object, ...]:
    expression = finding.effect.partition(" ~ ")[2] if is_unnamed(finding) else finding.effect
    return finding.scope, expression, finding.gap


def _merge(members: Sequence[Finding]) -> Finding:
    parameters, channels = dict[str, Estimate](), []
    for member in members:
        channel, _, expression = describe_term(member).partition(" ~ ")
        channels.append(channel)
        axis = channel.rpartition(".")[2]
        parameters |= {f"{axis} {name}": estimate for name, estimate in member.parameters.items()}
    effect = f"{PREFIX}{', '.join(channels)} ~ {expression}"
    return replace(members[0], effect=effect, parameters=parameters)


def select_amplitudes(finding: Finding) -> tuple[dict[str, Estimate], int]:
    """Return the parameters to show, of an unnamed term the most significant, and how many others it has."""
    parameters = dict(finding.parameters)
    if not is_unnamed(finding) or len(parameters) <= _MAX_AMPLITUDES:
        return parameters, 0

    def significance(name: str) -> float:
        return abs(parameters[name].value) / (parameters[name].sigma or np.inf)

    strongest = sorted(parameters, key=significance, reverse=True)[:_MAX_AMPLITUDES]
    return {name: parameters[name] for name in strongest}, len(parameters) - len(strongest)
