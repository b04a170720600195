"""Parts of the result of a gap search: findings, estimates and unexplained structure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from hubodo.effects import BY_NAME
from hubodo.effects.empirical import PREFIX

Verdict = Literal["no_gap", "explained", "partly_explained", "unexplained"]


@dataclass(frozen=True)
class BeforeAfter:
    """The gap before and after, in units of the declared noise; `floor`: the gap of noise alone."""

    before: float
    after: float
    floor: float | None = None

    def as_json(self) -> dict[str, float]:
        """Return the fields as JSON."""
        fields = {"before": self.before, "after": self.after}
        return fields if self.floor is None else {**fields, "floor": self.floor}


@dataclass(frozen=True)
class Estimate:
    """A parameter: value, 1 sigma (None if unobservable), unit, and value in the model file, if any."""

    value: float
    sigma: float | None
    unit: str
    model_value: float | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the entry of `parameters` in `gap.json`."""
        fields = {"value": self.value, "sigma": self.sigma, "unit": self.unit}
        return (
            fields
            if self.model_value is None
            else {**fields, "was": self.model_value, "change": self.value - self.model_value}
        )


@dataclass(frozen=True)
class Finding:
    """An effect that was detected and added to the model.

    Attributes
    ----------
    effect : str
        Name of the effect, or `empirical:` and the term without a name.
    scope : str
        Name of a node, `all` or `vehicle`.
    parameters : mapping of str to Estimate
        Estimated parameters with sigmas.
    gap, held_out_gap : BeforeAfter
        Gap before and after the effect was added, on all and on held-out samples.
    p_value : float
        Probability of at least this gain of the best candidate under the null hypothesis.
    confidence : float
        Posterior probability of the effect.
    where : str
        Channels, times and regimes of the residual that it explains, as text.
    runner_up : tuple or None
        Second most probable effect and its probability.
    inseparable_from : tuple of str
        Effects that this log cannot separate from it.
    rivals : tuple
        Effect, best scope, gain and probability over all scopes of every effect, the most probable first.
    """

    effect: str
    scope: str
    parameters: Mapping[str, Estimate]
    gap: BeforeAfter
    held_out_gap: BeforeAfter
    p_value: float
    confidence: float
    where: str
    runner_up: tuple[str, float] | None
    inseparable_from: tuple[str, ...]
    rivals: tuple[tuple[str, str, float, float], ...]

    @property
    def belongs_to_drive(self) -> bool:
        """Return True for an offset, a clock or the road, whose value holds for this drive only."""
        return not self.effect.startswith(PREFIX) and BY_NAME[self.effect].varies_between_drives

    def as_json(self) -> dict[str, Any]:
        """Return the entry of `found` in `gap.json`.

        Returns
        -------
        dict
            The JSON object.
        """
        runner = self.runner_up
        return {
            "effect": self.effect,
            "scope": self.scope,
            "parameters": {name: estimate.as_json() for name, estimate in self.parameters.items()},
            "of_this_drive": self.belongs_to_drive,
            "gap": self.gap.as_json(),
            "held_out_gap": self.held_out_gap.as_json(),
            "p_value": self.p_value,
            "confidence": self.confidence,
            "where": self.where,
            "runner_up": None if runner is None else {"effect": runner[0], "confidence": runner[1]},
            "inseparable_from": list(self.inseparable_from),
        }


@dataclass(frozen=True)
class Unexplained:
    """Structure that no effect explains: its channel, where it occurs, and what it resembles."""

    channel: str
    where: str
    looks_like: str

    def as_json(self) -> dict[str, str]:
        """Return the entry of `remaining` in `gap.json`."""
        return {"channel": self.channel, "where": self.where, "looks_like": self.looks_like}


def split_by_channel(finding: Finding) -> list[Finding]:
    """Split an unnamed term into one finding per channel, `empirical:left.gz ~ term`."""
    channels, _, term = finding.effect.removeprefix(PREFIX).partition(" ~ ")
    findings = []
    for channel in channels.split(","):
        parameters = {
            name.removeprefix(channel).lstrip("_") or "amplitude": value
            for name, value in finding.parameters.items()
            if name.partition("_")[0] == channel
        }
        effect = f"{PREFIX}{finding.scope}.{channel} ~ {term}"
        findings.append(replace(finding, effect=effect, parameters=parameters))
    return findings
