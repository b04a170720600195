"""Printed tables of results: shares with intervals, confusions, reductions of the gap."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest

from gap_matrix.judge import lines, score
from gap_matrix.judge.cells import TABLES

Row = dict[str, Any]
Test = Callable[[Any, Any], bool]


def all_tables(rows: Sequence[Row]) -> Iterator[str]:
    """Return the text of each table that has rows."""
    makers = {
        "singles": _singles,
        "nulls": _nulls,
        "pairs": _pairs,
        "open": _open,
        "alike": _alike,
        "controls": _controls,
        "long": _long,
    }
    for table in TABLES:
        here = [row for row in rows if row["table"] == table]
        if here:
            good = [row for row in here if "result" in row and "error" not in row]
            lost = [row for row in here if row not in good]
            text = [makers[table](good)] if good else []
            text += [f"  not judged: {lines.line(row)}" for row in lost]
            if good:
                seconds = [row["seconds"] for row in good]
                text.append(
                    f"  time of a diagnosis: median {np.median(seconds):.1f} s, at most {max(seconds):.1f} s"
                )
            yield "\n".join(text)


def share(hits: Sequence[bool]) -> str:
    """Return `7/10 70 % (35..93)`, with the Clopper-Pearson 95 % interval."""
    if not hits:
        return "0/0"
    found = binomtest(int(sum(hits)), len(hits)).proportion_ci(0.95, "exact")
    percent = 100 * np.mean(hits)
    return f"{sum(hits)}/{len(hits)} {percent:.1f} % ({100 * found.low:.1f}..{100 * found.high:.1f})"


def _share(rows: Sequence[Row], test: Test) -> str:
    return share([test(row["result"], row["truth"]) for row in rows])


def _groups(rows: Sequence[Row], *keys: str) -> Iterator[tuple[str, list[Row]]]:
    order: dict[str, list[Row]] = {}
    for row in rows:
        order.setdefault(", ".join(row[key] for key in keys), []).append(row)
    yield from order.items()


def _singles(rows: Sequence[Row]) -> str:
    out = ["Singles: one hidden effect (95 % intervals, exact)"]
    for strength, here in _groups(rows, "variant"):
        out.append(f" {strength}, {len(here)} logs")
        out.append(f"  named first                 {_share(here, score.named_first)}")
        out.append(f"  named, and nothing else     {_share(here, score.exact)}")
        out.append(f"  named first, scope right    {_share(here, score.scope_right)}")
        out.append(f"  nothing named               {share([not row['result']['found'] for row in here])}")
        empirical = [score.first(row["result"]).startswith(score.EMPIRICAL) for row in here]
        out.append(f"  an empirical term first     {share(empirical)}")
        wrong = [bool(score.sure_and_wrong(row["result"], row["truth"])) for row in here]
        out.append(f"  wrong, confidence > {score.SURE}     {share(wrong)}")
        out.append(f"  parameters                  {_parameters(here)}")
        out.append(f"  held-out gap closed         {_closed(here, 'oracle')}")
    out.append(" by effect: named first of logs, by strength")
    strengths = list(dict.fromkeys(row["variant"] for row in rows))
    for name, here in _groups(rows, "name"):
        cells = []
        for strength in strengths:
            hits = [score.named_first(r["result"], r["truth"]) for r in here if r["variant"] == strength]
            cells.append(f"{sum(hits)}/{len(hits)}".rjust(7))
        errors = [score.deviations(row["result"], row["truth"])[0] for row in here]
        flat = [abs(z) for one in errors for z in one]
        largest = f"   largest |z| {max(flat):.1f}" if flat else ""
        out.append(f"  {name:24s}{''.join(cells)}{largest}")
    out.append(" confusions: truth -> first name (logs)")
    pairs = Counter(
        (row["variant"], row["name"], score.first(row["result"]))
        for row in rows
        if not score.named_first(row["result"], row["truth"])
    )
    out += [f"  {a}: {b} -> {c} ({n})" for (a, b, c), n in sorted(pairs.items())]
    return "\n".join(out)


def _parameters(rows: Sequence[Row]) -> str:
    made = [score.deviations(row["result"], row["truth"]) for row in rows]
    z = np.abs([value for found, _ in made for value in found])
    if not len(z):
        return "none to compare"
    return (
        f"within 3 sigma {share((z < 3).tolist())}, within 1 sigma {100 * np.mean(z < 1):.0f} %; "
        f"without a sigma {sum(skipped for _, skipped in made)}"
    )


def _closed(rows: Sequence[Row], key: str) -> str:
    """Return shares of the rows in which the oracle reduces the gap."""
    shares = []
    for row in rows:
        gap = row["result"]["held_out_gap"] if key == "oracle" else row[key]["held_out_gap"]
        value = score.closed(gap, row["oracle"]["held_out_gap"])
        if value is not None:
            shares.append(value)
    return _spread(shares, len(rows))


def _spread(shares: Sequence[float], count: int) -> str:
    if not shares:
        return "the oracle closes nothing in any"
    low, middle = np.percentile(shares, [10, 50])
    worse = 100 * np.mean(np.array(shares) < 0)
    return (
        f"median {middle:.3f} of the oracle's, 10th percentile {low:.3f}, worse than before {worse:.1f} % "
        f"(oracle closes something in {len(shares)} of {count})"
    )


def _nulls(rows: Sequence[Row]) -> str:
    out = ["Nulls: nothing hidden (95 % intervals, exact)"]
    for variant, here in [*_groups(rows, "variant"), ("all", list(rows))]:
        out.append(f"  {variant:28s} false alarms {share([bool(row['result']['found']) for row in here])}")
    structure = [row["result"]["verdict"] == "unexplained" for row in rows]
    out.append(f"  {'all':28s} called unexplained {share(structure)}")
    return "\n".join(out)


def _pairs(rows: Sequence[Row]) -> str:
    weaker = []
    for row in rows:
        gains = row["truth"]["gain_nats"]
        name = row["truth"]["effects"][int(np.argmin(gains))]["name"]
        weaker.append(name in score.names(row["result"]))
    both = [{e["name"] for e in row["truth"]["effects"]} <= set(score.names(row["result"])) for row in rows]
    wrong = [bool(score.sure_and_wrong(row["result"], row["truth"])) for row in rows]
    overlap = np.mean([score.jaccard(row["result"], row["truth"]) for row in rows])
    return "\n".join(
        [
            "Pairs: two hidden effects, medium to strong (95 % intervals, exact)",
            f"  both named, nothing else    {_share(rows, score.exact)}",
            f"  both named                  {share(both)}",
            f"  weaker one named            {share(weaker)}",
            f"  wrong, confidence > {score.SURE}     {share(wrong)}",
            f"  Jaccard, mean               {overlap:.3f}",
            f"  parameters                  {_parameters(rows)}",
        ]
    )


def _open(rows: Sequence[Row]) -> str:
    """Return counts by kind, and totals with intervals."""
    out = ["Open set: one hidden effect that is outside the vocabulary (95 % intervals, exact)"]
    out.append(f"  {'kind, of logs':34s}{'wrong, sure':>12s}{'channel':>9s}{'and dependence':>16s}   sure of")
    for name, here in _groups(rows, "name", "variant"):
        wrong, told, names = _outside(here)
        most = ", ".join(f"{given} ({n})" for given, n in names.most_common(3))
        counts = [sum(wrong), sum(c for c, _ in told), sum(d for _, d in told)]
        cells = [f"{n}/{len(here)}" for n in counts]
        out.append(f"  {name:34s}{cells[0]:>12s}{cells[1]:>9s}{cells[2]:>16s}   {most or '-'}")
    for strength, here in [*_groups(rows, "variant"), ("all", list(rows))]:
        wrong, told, _ = _outside(here)
        silent = [not row["result"]["found"] and not row["result"]["remaining"] for row in here]
        out.append(f" {strength}, {len(here)} logs")
        out.append(f"  wrong, confidence > {score.SURE}     {share(wrong)}")
        out.append(f"  described: right channel    {share([channel for channel, _ in told])}")
        out.append(f"   and the right dependence   {share([dependence for _, dependence in told])}")
        out.append(f"  not a word                  {share(silent)}")
    return "\n".join(out)


def _outside(rows: Sequence[Row]) -> tuple[list[bool], list[tuple[bool, bool]], Counter[str]]:
    wrong = [score.sure_and_wrong(row["result"], row["truth"]) for row in rows]
    told = [score.described(row["result"], row["truth"]) for row in rows]
    return [bool(names) for names in wrong], told, Counter(name for names in wrong for name in names)


def _alike(rows: Sequence[Row]) -> str:
    out = ["Look-alikes: one of a pair hidden, on a drive that tells them apart (strong) and on a blunt one"]
    for where, here in _groups(rows, "variant"):
        wrong = [bool(score.sure_and_wrong(row["result"], row["truth"])) for row in here]
        out.append(f" {where}, {len(here)} logs")
        out.append(f"  named first                 {_share(here, score.named_first)}")
        out.append(f"  in the set that is given    {_share(here, score.in_the_set)}")
        out.append(f"  wrong, confidence > {score.SURE}     {share(wrong)}")
        if where == "blunt":
            out.append(f"  doubt admitted              {_share(here, score.admits_doubt)}")
    for name, pair in _groups(rows, "name"):
        out.append(f" {name}; blunt: {next((r['truth']['why'] for r in pair if r['truth']['why']), '-')}")
        order: dict[tuple[str, str], Counter[str]] = {}
        for row in pair:
            key = row["variant"], row["truth"]["effects"][0]["name"]
            order.setdefault(key, Counter())[lines.head_of(row["result"])] += 1
        for (where, hidden), answers in order.items():
            given = ", ".join(f"{n} x {text}" for text, n in answers.most_common())
            out.append(f"  {where:12s}{hidden:22s} -> {given}")
    return "\n".join(out)


def _controls(rows: Sequence[Row]) -> str:
    hidden = [row for row in rows if "oracle" in row]
    out = [
        f"Controls: strong effects, {len(hidden)} logs; held-out gap closed, relative to the true name fitted"
    ]
    if hidden:
        out.append(f"  what was found          {_closed(hidden, 'oracle')}")
        for key, words in (("runner_up", "runner-up forced in"), ("random", "random name forced in")):
            out.append(f"  {words:24s}{_closed(hidden, key)}")
        less = [
            row["runner_up"]["held_out_gap"]["after"] > row["result"]["held_out_gap"]["after"]
            for row in hidden
        ]
        out.append(f"  runner-up leaves a larger held-out gap than what was found: {share(less)}")
        boxed = [row for row in hidden if "black_box" in row]
        if boxed:
            made = [score.closed(row["black_box"], row["oracle"]["held_out_gap"]) for row in boxed]
            words = _spread([value for value in made if value is not None], len(boxed))
            out.append(f"  regression, no names    {words}")
    permuted = [row["permuted"]["found"] for row in hidden if "permuted" in row]
    if permuted:
        named = [("gyro_temperature" in found) for found in permuted]
        out.append(f"  temperature permuted in blocks, gyro_temperature hidden: named {share(named)}")
    nulls = [bool(row["result"]["found"]) for row in rows if row["variant"] == "permuted temperature"]
    if nulls:
        out.append(f"  temperature permuted in blocks, nothing hidden: false alarms {share(nulls)}")
    return "\n".join(out)


def _long(rows: Sequence[Row]) -> str:
    return "\n".join(
        [
            f"Long: {', '.join(sorted({row['name'] + ', ' + row['variant'] for row in rows}))}",
            f"  named, and nothing else     {_share(rows, score.exact)}",
            f"  named first, scope right    {_share(rows, score.scope_right)}",
            f"  parameters                  {_parameters(rows)}",
        ]
    )
