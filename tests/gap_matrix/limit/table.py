"""The table of limits: sizes that are named and seen in half and in nine of ten drives, and their ratios."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gap_matrix.effects import KINDS
from gap_matrix.limit.curve import Curve, fitted, size_seen
from gap_matrix.limit.oracle import CANDIDATES, FALSE_ALARM, half_seen
from hubodo.effects import BY_NAME

SHARES = (0.5, 0.9)
# What more than this separates from the oracle has a reason of its own.
WANTED = 1.5
# Nats by which a name has to fit better than another; what is nearer `gap` calls inseparable.
TOLD = 3.0
Row = Mapping[str, Any]


@dataclass(frozen=True)
class Limit:
    """One effect. named, priced, alone: sizes at SHARES, of `gap`, of the oracle with the price and without.

    curve: of `gap`, over ln of size over the drive's own limit. instead: what was said beyond the middle.
    screened: gain in the logs over what the oracle counts on, median. told, rival: size at which half of the
    drives tell it by TOLD nats from the name that imitates it best; nan and "" where it is of chance.
    """

    name: str
    unit: str
    named: tuple[float, float]
    priced: tuple[float, float]
    alone: tuple[float, float]
    ratios: tuple[float, float]
    curve: Curve
    trials: tuple[tuple[float, bool], ...]
    instead: str
    screened: float
    told: float
    rival: str


def limit(name: str, trials: Sequence[Row], powers: Sequence[Row], typical: float) -> Limit:
    """trials: of one effect. powers: of the oracle, a drive each. typical: size at factor 1."""
    curve = fitted([row["x"] for row in trials], [row["named"] for row in trials])
    halves = np.log([half_seen(own["factors"], own["priced"]) for own in powers])

    def by_gap(factor: float) -> float:
        return float(np.mean(curve.seen(np.log(factor) - halves)))

    def by_oracle(factor: float, kind: str) -> float:
        x = np.log(factor)
        shares = [np.interp(x, np.log(own["factors"]), own[kind], left=0.0, right=1.0) for own in powers]
        return float(np.mean(shares))

    least = float(np.median([own.get("least", 0.0) for own in powers]))
    named = [max(size_seen(by_gap, share), least) for share in SHARES]
    priced = [size_seen(lambda f: by_oracle(f, "priced"), share) for share in SHARES]
    alone = [size_seen(lambda f: by_oracle(f, "one"), share) for share in SHARES]

    def sizes(factors: Sequence[float]) -> tuple[float, float]:
        made = [typical / one if KINDS[name].limit else typical * one for one in factors]
        return made[0], made[1]

    parameter = next(key for key in KINDS[name].draw(np.random.default_rng(0)) if key != KINDS[name].lasting)
    return Limit(
        name,
        BY_NAME[name].unit(parameter),
        sizes(named),
        sizes(priced),
        sizes(alone),
        (named[0] / priced[0], named[1] / priced[1]),
        curve,
        tuple((row["x"], row["named"]) for row in trials),
        _instead([row for row in trials if not row["named"] and row["x"] > curve.middle - 0.2]),
        _as_promised(trials),
        *_told(powers, typical),
    )


def _told(powers: Sequence[Row], typical: float) -> tuple[float, str]:
    """See `Limit`."""
    seen = [own["seen"] for own in powers if own.get("seen")]
    if not seen:
        return float("nan"), ""
    factors = [float(np.sqrt(2.0 * TOLD / max(one["beside"], 1e-9))) for one in seen]
    return typical * float(np.median(factors)), Counter(one["rival"] for one in seen).most_common(1)[0][0]


def _instead(missed: Sequence[Row]) -> str:
    """What was said in place of the name, the most frequent first."""
    said = Counter(_said(row) for row in missed)
    return ", ".join(f"{words} {count}" for words, count in said.most_common(3))


def _said(row: Row) -> str:
    if not row["found"]:
        return "nothing"
    name, scope, confidence = row["found"][0][:3]
    if name == row["key"].partition("/")[0]:
        return f"scope {scope}" if scope != row["scope"] else f"{confidence:.2f}"
    return str(name).partition(" ~ ")[0]


def _as_promised(trials: Sequence[Row]) -> float:
    """Gain in the logs over the one that the oracle counts on, median; nan for what is of chance."""
    made = [row["screened"] / row["expected"] for row in trials if row.get("expected") and row["screened"]]
    return float(np.median(made)) if made else float("nan")


def text(limits: Sequence[Limit], rows: Mapping[str, Row], seeds: Sequence[int]) -> str:
    """All of it in words and numbers."""
    lines = [
        "",
        "named: first, in its scope, confidence above 0.5. oracle: knows name, scope and sign; "
        f"{FALSE_ALARM:.0%} false alarms",
        f"a log, shared by the {CANDIDATES} names in their scopes; alone: not shared. told: {TOLD:.0f} nats "
        "better than its nearest rival",
        "",
        f"{'':22} {'unit':>13} {'named':>19} {'oracle':>19} {'alone':>9} {'told':>9} {'ratio':>12}",
        " " * 36
        + "".join(f"{share:>10}" for share in ("50 %", "90 %", "50 %", "90 %", "50 %", "50 %"))
        + "  50 %   ±   90 %  seen, said instead; nearest rival",
    ]
    for it in limits:
        spread = it.curve.spread(0.5)
        lines.append(
            f"{it.name:22} {it.unit:>13} {it.named[0]:9.3g} {it.named[1]:9.3g} {it.priced[0]:9.3g} "
            f"{it.priced[1]:9.3g} {it.alone[0]:9.3g} {it.told:9.3g} {it.ratios[0]:5.2f} {spread:4.2f} "
            f"{it.ratios[1]:5.2f}  {sum(seen for _, seen in it.trials):2}/{len(it.trials):2} "
            f"{it.instead}; {it.rival}"
        )
    beyond = [it.name for it in limits if it.ratios[0] > WANTED]
    alarms = [seed for seed in seeds if rows[f"nothing/{seed}"]["found"]]
    lines += [
        "",
        f"ratio at most {WANTED} at 50 %: {len(limits) - len(beyond)} of {len(limits)}; beyond: "
        f"{', '.join(beyond) or 'none'}; median {np.median([it.ratios[0] for it in limits]):.2f}; "
        f"at 90 %: {sum(it.ratios[1] <= WANTED for it in limits)} of {len(limits)}",
        "gain over what the oracle counts on, median of all: "
        f"{np.nanmedian([it.screened for it in limits]):.2f}",
        f"nothing hidden in the same drives: something named in {len(alarms)} of {len(seeds)}",
    ]
    return "\n".join(lines)
