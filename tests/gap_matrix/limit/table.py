"""Table of limits: sizes named, detected and distinguished in 50 and 90 % of the drives, and their ratios.

Seen: by an oracle that knows name, scope and sign, at false alarms that all names share. Told: by one that
    has to choose, too: seen, and name and scope more probable than all others together.
"""

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
Row = Mapping[str, Any]


@dataclass(frozen=True)
class Limit:
    """One effect. named, priced, told, alone: sizes at SHARES, of `gap` and of the oracle: seen at the shared
    price, chosen as well, seen without the price.

    over_seen, over_told: what is named over what is seen, and over what is told. curve: of `gap`, over ln of
    size over the size that is seen in the drive. instead: what was said beyond the middle. screened: gain in
    the logs over what the oracle counts on, median; nan for what is of chance. rival: what the oracle takes
    it for most often, where half of its logs are told.
    """

    name: str
    unit: str
    named: tuple[float, float]
    priced: tuple[float, float]
    told: tuple[float, float]
    alone: tuple[float, float]
    over_seen: tuple[float, float]
    over_told: tuple[float, float]
    curve: Curve
    trials: tuple[tuple[float, bool], ...]
    instead: str
    screened: float
    rival: str

    @property
    def told_over_seen(self) -> float:
        """What choosing costs, at 50 %."""
        return self.over_seen[0] / self.over_told[0]


def limit(name: str, trials: Sequence[Row], powers: Sequence[Row], typical: float) -> Limit:
    """Return the limits of one effect.

    trials: of that effect
    powers: of the oracle, one per drive
    typical: size at factor 1
    """
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
    told = [size_seen(lambda f: by_oracle(f, "told"), share) for share in SHARES]
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
        sizes(told),
        sizes(alone),
        (named[0] / priced[0], named[1] / priced[1]),
        (named[0] / told[0], named[1] / told[1]),
        curve,
        tuple((row["x"], row["named"]) for row in trials),
        _instead([row for row in trials if not row["named"] and row["x"] > curve.middle - 0.2]),
        _as_promised(trials),
        Counter(own["rival"] for own in powers).most_common(1)[0][0],
    )


def _instead(missed: Sequence[Row]) -> str:
    """Return the names given instead, the most frequent first."""
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
    """Return the median gain in the logs over the oracle's; nan for effects of chance."""
    made = [row["screened"] / row["expected"] for row in trials if row.get("expected") and row["screened"]]
    return float(np.median(made)) if made else float("nan")


def text(limits: Sequence[Limit], rows: Mapping[str, Row], seeds: Sequence[int]) -> str:
    """Return the table as text."""
    lines = [
        "",
        "named: first, in its scope, confidence above 0.5. seen: by an oracle that knows name, scope, sign,",
        f"at {FALSE_ALARM:.0%} false alarms a log, shared by the {CANDIDATES} names in their scopes; alone: "
        "not shared. told: seen so,",
        "and more probable than all other names together, in its scope. over: named over seen, or over told",
        "",
        f"{'':22} {'unit':>13} {'named':>19} {'seen':>19} {'told':>19} {'alone':>9} {'over seen':>11} "
        f"{'over told':>17}",
        " " * 36
        + "".join(f"{share:>10}" for share in ("50 %", "90 %") * 3)
        + "      50 %   50 %  90 %   50 %   ±   90 %  seen, said instead; nearest rival",
    ]
    for it in limits:
        sizes = "".join(f" {size:9.3g}" for size in (*it.named, *it.priced, *it.told, it.alone[0]))
        hits = sum(seen for _, seen in it.trials)
        lines.append(
            f"{it.name:22} {it.unit:>13}{sizes} {it.over_seen[0]:5.2f} {it.over_seen[1]:5.2f}  "
            f"{it.over_told[0]:5.2f} {it.curve.spread(0.5):4.2f} {it.over_told[1]:5.2f}  "
            f"{hits:2}/{len(it.trials):2} {it.instead}; {it.rival}"
        )
    alarms = [seed for seed in seeds if rows[f"nothing/{seed}"]["found"]]
    lines += [
        "",
        _summary("seen", [(it.name, it.over_seen) for it in limits]),
        _summary("told", [(it.name, it.over_told) for it in limits]),
        "gain over what the oracle counts on, median of all: "
        f"{np.nanmedian([it.screened for it in limits]):.2f}",
        f"nothing hidden in the same drives: something named in {len(alarms)} of {len(seeds)}",
    ]
    return "\n".join(lines)


def _summary(what: str, ratios: Sequence[tuple[str, tuple[float, float]]]) -> str:
    """Return the number of effects near the oracle, and the others by name."""
    beyond = [f"{name} {half:.2f}" for name, (half, _) in ratios if half > WANTED]
    return (
        f"at most {WANTED} times what is {what}, at 50 %: {len(ratios) - len(beyond)} of {len(ratios)}; "
        f"beyond: {', '.join(beyond) or 'none'}; median {np.median([half for _, (half, _) in ratios]):.2f}; "
        f"at 90 %: {sum(most <= WANTED for _, (_, most) in ratios)} of {len(ratios)}"
    )
