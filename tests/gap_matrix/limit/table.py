"""Table of limits: sizes named, detected and identified in 50 and 90 % of the drives, and their ratios.

Named: by `gap`. Detected: by an oracle that knows name, scope and sign, at a false alarm shared by all names.
Identified: detected, and name and scope more probable than all others together.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gap_matrix.effects import KINDS
from gap_matrix.limit.curve import DetectionCurve, fit_curve, solve_size
from gap_matrix.limit.oracle import FALSE_ALARM, N_CANDIDATES, interpolate_half_size
from hubodo.effects import BY_NAME

DETECTION_SHARES = (0.5, 0.9)
# Largest ratio to the oracle that needs no explanation.
MAX_RATIO = 1.5
Row = Mapping[str, Any]


@dataclass(frozen=True)
class EffectLimit:
    """Limits of one effect; sizes and ratios are those at DETECTION_SHARES.

    named: sizes that `gap` names
    detected, identified: sizes that the oracle detects and identifies, with a shared false alarm
    detected_alone: sizes that the oracle detects with a false alarm for this effect alone
    named_over_detected, named_over_identified: named size over the detected and over the identified one
    curve: of `gap`, over ln of the size relative to the size detected in the drive
    trials: ln of the relative size of each trial, and whether it was named
    alternatives: most frequent answers of missed trials above the middle of the curve
    gain_ratio: median gain in the logs over that expected by the oracle; nan for random effects
    nearest_alternative: most frequent alternative of the oracle
    """

    name: str
    unit: str
    named: tuple[float, float]
    detected: tuple[float, float]
    identified: tuple[float, float]
    detected_alone: tuple[float, float]
    named_over_detected: tuple[float, float]
    named_over_identified: tuple[float, float]
    curve: DetectionCurve
    trials: tuple[tuple[float, bool], ...]
    alternatives: str
    gain_ratio: float
    nearest_alternative: str

    @property
    def identified_over_detected(self) -> float:
        """Return the identified size over the detected one, at 50 %."""
        return self.named_over_detected[0] / self.named_over_identified[0]


def compute_limit(name: str, trials: Sequence[Row], powers: Sequence[Row], typical: float) -> EffectLimit:
    """Return the limits of one effect.

    trials: rows of this effect
    powers: of the oracle, one per drive
    typical: size at factor 1
    """
    curve = fit_curve([row["x"] for row in trials], [row["named"] for row in trials])
    ln_half_sizes = np.log([interpolate_half_size(power["factors"], power["priced"]) for power in powers])

    def share_of_gap(factor: float) -> float:
        return float(np.mean(curve.detection_probability(np.log(factor) - ln_half_sizes)))

    def share_of_oracle(factor: float, kind: str) -> float:
        x = np.log(factor)
        shares = [
            np.interp(x, np.log(power["factors"]), power[kind], left=0.0, right=1.0) for power in powers
        ]
        return float(np.mean(shares))

    min_factor = float(np.median([power.get("least", 0.0) for power in powers]))
    named = [max(solve_size(share_of_gap, share), min_factor) for share in DETECTION_SHARES]
    detected = [
        solve_size(lambda factor: share_of_oracle(factor, "priced"), share) for share in DETECTION_SHARES
    ]
    identified = [
        solve_size(lambda factor: share_of_oracle(factor, "told"), share) for share in DETECTION_SHARES
    ]
    detected_alone = [
        solve_size(lambda factor: share_of_oracle(factor, "one"), share) for share in DETECTION_SHARES
    ]

    def sizes(factors: Sequence[float]) -> tuple[float, float]:
        scaled = [typical / factor if KINDS[name].is_limit else typical * factor for factor in factors]
        return scaled[0], scaled[1]

    parameter = next(
        key for key in KINDS[name].draw(np.random.default_rng(0)) if key != KINDS[name].shape_parameter
    )
    return EffectLimit(
        name,
        BY_NAME[name].unit(parameter),
        sizes(named),
        sizes(detected),
        sizes(identified),
        sizes(detected_alone),
        (named[0] / detected[0], named[1] / detected[1]),
        (named[0] / identified[0], named[1] / identified[1]),
        curve,
        tuple((row["x"], row["named"]) for row in trials),
        _list_alternatives([row for row in trials if not row["named"] and row["x"] > curve.middle - 0.2]),
        _median_gain_ratio(trials),
        Counter(power["rival"] for power in powers).most_common(1)[0][0],
    )


def _list_alternatives(missed: Sequence[Row]) -> str:
    """Return the answers of missed trials, the most frequent first."""
    counts = Counter(_describe_answer(row) for row in missed)
    return ", ".join(f"{answer} {count}" for answer, count in counts.most_common(3))


def _describe_answer(row: Row) -> str:
    """Return the first finding of a missed trial: name, wrong scope, low confidence, or nothing."""
    if not row["found"]:
        return "nothing"
    name, scope, confidence = row["found"][0][:3]
    if name == row["key"].partition("/")[0]:
        return f"scope {scope}" if scope != row["scope"] else f"{confidence:.2f}"
    return str(name).partition(" ~ ")[0]


def _median_gain_ratio(trials: Sequence[Row]) -> float:
    """Return the median gain in the logs over that expected by the oracle; nan for random effects."""
    ratios = [row["screened"] / row["expected"] for row in trials if row.get("expected") and row["screened"]]
    return float(np.median(ratios)) if ratios else float("nan")


def format_table(limits: Sequence[EffectLimit], rows: Mapping[str, Row], seeds: Sequence[int]) -> str:
    """Return the table as text."""
    lines = [
        "",
        "named: first, in its scope, confidence above 0.5. detected: by an oracle that knows name, scope and",
        f"sign, at {FALSE_ALARM:.0%} false alarms per log, shared by the {N_CANDIDATES} names in their "
        "scopes; alone: not shared.",
        "identified: detected, and more probable than all other names together, in its scope.",
        "ratios: named over detected, named over identified.",
        "",
        f"{'':22} {'unit':>13} {'named':>19} {'detected':>19} {'identified':>19} {'alone':>9} "
        f"{'/ detected':>11} {'/ identified':>17}",
        " " * 36
        + "".join(f"{share:>10}" for share in ("50 %", "90 %") * 3)
        + "      50 %   50 %  90 %   50 %   ±   90 %  named, other answers; nearest alternative",
    ]
    for limit in limits:
        sizes = "".join(
            f" {size:9.3g}"
            for size in (*limit.named, *limit.detected, *limit.identified, limit.detected_alone[0])
        )
        n_named = sum(is_named for _, is_named in limit.trials)
        over_detected, over_identified = limit.named_over_detected, limit.named_over_identified
        lines.append(
            f"{limit.name:22} {limit.unit:>13}{sizes} {over_detected[0]:5.2f} {over_detected[1]:5.2f}  "
            f"{over_identified[0]:5.2f} {limit.curve.ln_size_sigma(0.5):4.2f} {over_identified[1]:5.2f}  "
            f"{n_named:2}/{len(limit.trials):2} {limit.alternatives}; {limit.nearest_alternative}"
        )
    alarm_seeds = [seed for seed in seeds if rows[f"nothing/{seed}"]["found"]]
    lines += [
        "",
        _summary("detected", [(limit.name, limit.named_over_detected) for limit in limits]),
        _summary("identified", [(limit.name, limit.named_over_identified) for limit in limits]),
        "gain over that expected by the oracle, median of all: "
        f"{np.nanmedian([limit.gain_ratio for limit in limits]):.2f}",
        f"same drives without a hidden effect: false alarms in {len(alarm_seeds)} of {len(seeds)}",
    ]
    return "\n".join(lines)


def _summary(criterion: str, ratios: Sequence[tuple[str, tuple[float, float]]]) -> str:
    """Return the number of effects near the oracle, and the others by name."""
    median = np.median([half for _, (half, _) in ratios])
    exceeding = [f"{name} {half:.2f}" for name, (half, _) in ratios if half > MAX_RATIO]
    return (
        f"at most {MAX_RATIO} times the size {criterion}, at 50 %: "
        f"{len(ratios) - len(exceeding)} of {len(ratios)}; "
        f"above: {', '.join(exceeding) or 'none'}; median {median:.2f}; "
        f"at 90 %: {sum(ratio_90 <= MAX_RATIO for _, (_, ratio_90) in ratios)} of {len(ratios)}"
    )
