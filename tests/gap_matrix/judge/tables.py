"""Printed tables of results: shares with intervals, confusions, and reductions of the gap."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest

from gap_matrix.judge import lines, score
from gap_matrix.judge.cells import TABLES

Row = dict[str, Any]
Criterion = Callable[[Any, Any], bool]


def format_tables(rows: Sequence[Row]) -> Iterator[str]:
    """Return the text of each table that has rows."""
    formatters = {
        "singles": _singles,
        "nulls": _nulls,
        "pairs": _pairs,
        "open": _open_set,
        "alike": _confusable,
        "controls": _controls,
        "long": _long,
    }
    for table in TABLES:
        group = [row for row in rows if row["table"] == table]
        if group:
            valid_rows = [row for row in group if "result" in row and "error" not in row]
            failed_rows = [row for row in group if row not in valid_rows]
            text = [formatters[table](valid_rows)] if valid_rows else []
            text += [f"  not judged: {lines.format_row(row)}" for row in failed_rows]
            if valid_rows:
                seconds = [row["seconds"] for row in valid_rows]
                text.append(
                    f"  time of a diagnosis: median {np.median(seconds):.1f} s, at most {max(seconds):.1f} s"
                )
            yield "\n".join(text)


def format_share(hits: Sequence[bool]) -> str:
    """Return `7/10 70 % (35..93)`, with the Clopper-Pearson 95 % interval."""
    if not hits:
        return "0/0"
    interval = binomtest(int(sum(hits)), len(hits)).proportion_ci(0.95, "exact")
    percent = 100 * np.mean(hits)
    return f"{sum(hits)}/{len(hits)} {percent:.1f} % ({100 * interval.low:.1f}..{100 * interval.high:.1f})"


def _format_score_share(rows: Sequence[Row], is_hit: Criterion) -> str:
    """Return the share of rows that meet a criterion on result and truth."""
    return format_share([is_hit(row["result"], row["truth"]) for row in rows])


def _group_rows(rows: Sequence[Row], *keys: str) -> Iterator[tuple[str, list[Row]]]:
    """Yield the rows with equal values of the keys, and these values, in order of first appearance."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(", ".join(row[key] for key in keys), []).append(row)
    yield from groups.items()


def _singles(rows: Sequence[Row]) -> str:
    """Return the table of logs with one hidden effect."""
    table_lines = ["Singles: one hidden effect (95 % intervals, exact)"]
    for strength, group in _group_rows(rows, "variant"):
        table_lines.append(f" {strength}, {len(group)} logs")
        table_lines.append(
            f"  named first                 {_format_score_share(group, score.is_named_first)}"
        )
        table_lines.append(f"  named, and nothing else     {_format_score_share(group, score.is_exact)}")
        table_lines.append(
            f"  named first, correct scope  {_format_score_share(group, score.is_scope_correct)}"
        )
        table_lines.append(
            f"  nothing named               {format_share([not row['result']['found'] for row in group])}"
        )
        empirical = [score.first_name(row["result"]).startswith(score.EMPIRICAL) for row in group]
        table_lines.append(f"  an empirical term first     {format_share(empirical)}")
        has_confident_error = [
            bool(score.confident_wrong_names(row["result"], row["truth"])) for row in group
        ]
        table_lines.append(
            f"  wrong, confidence > {score.CONFIDENCE_THRESHOLD}     {format_share(has_confident_error)}"
        )
        table_lines.append(f"  parameters                  {_parameters(group)}")
        table_lines.append(f"  held-out gap closed         {_format_gap_closure(group, 'oracle')}")
    table_lines.append(" by effect: named first of logs, by strength")
    strengths = list(dict.fromkeys(row["variant"] for row in rows))
    for name, group in _group_rows(rows, "name"):
        cells = []
        for strength in strengths:
            hits = [score.is_named_first(r["result"], r["truth"]) for r in group if r["variant"] == strength]
            cells.append(f"{sum(hits)}/{len(hits)}".rjust(7))
        errors = [score.parameter_errors(row["result"], row["truth"])[0] for row in group]
        z_scores = [abs(z) for row_errors in errors for z in row_errors]
        largest = f"   largest |z| {max(z_scores):.1f}" if z_scores else ""
        table_lines.append(f"  {name:24s}{''.join(cells)}{largest}")
    table_lines.append(" confusions: truth -> first name (logs)")
    pairs = Counter(
        (row["variant"], row["name"], score.first_name(row["result"]))
        for row in rows
        if not score.is_named_first(row["result"], row["truth"])
    )
    table_lines += [f"  {a}: {b} -> {c} ({n})" for (a, b, c), n in sorted(pairs.items())]
    return "\n".join(table_lines)


def _parameters(rows: Sequence[Row]) -> str:
    """Return the shares of parameter errors within 3 and within 1 sigma."""
    errors_and_skipped = [score.parameter_errors(row["result"], row["truth"]) for row in rows]
    z = np.abs([value for errors, _ in errors_and_skipped for value in errors])
    if not len(z):
        return "none to compare"
    return (
        f"within 3 sigma {format_share((z < 3).tolist())}, within 1 sigma {100 * np.mean(z < 1):.0f} %; "
        f"without a sigma {sum(skipped for _, skipped in errors_and_skipped)}"
    )


def _format_gap_closure(rows: Sequence[Row], key: str) -> str:
    """Return the reduction of the held-out gap relative to the oracle, where the oracle reduces it."""
    closures = []
    for row in rows:
        gap = row["result"]["held_out_gap"] if key == "oracle" else row[key]["held_out_gap"]
        value = score.gap_closure(gap, row["oracle"]["held_out_gap"])
        if value is not None:
            closures.append(value)
    return _format_closures(closures, len(rows))


def _format_closures(closures: Sequence[float], count: int) -> str:
    """Return median and 10th percentile of relative reductions of the gap."""
    if not closures:
        return "the oracle reduces no gap"
    low, median = np.percentile(closures, [10, 50])
    percent_worse = 100 * np.mean(np.array(closures) < 0)
    return (
        f"median {median:.3f} of the oracle's, 10th percentile {low:.3f}, "
        f"gap increased in {percent_worse:.1f} % (oracle reduces the gap in {len(closures)} of {count})"
    )


def _nulls(rows: Sequence[Row]) -> str:
    """Return the table of logs without hidden effects."""
    table_lines = ["Nulls: nothing hidden (95 % intervals, exact)"]
    for variant, group in [*_group_rows(rows, "variant"), ("all", list(rows))]:
        table_lines.append(
            f"  {variant:28s} false alarms {format_share([bool(row['result']['found']) for row in group])}"
        )
    is_unexplained = [row["result"]["verdict"] == "unexplained" for row in rows]
    table_lines.append(f"  {'all':28s} called unexplained {format_share(is_unexplained)}")
    return "\n".join(table_lines)


def _pairs(rows: Sequence[Row]) -> str:
    """Return the table of logs with two hidden effects."""
    is_weaker_named = []
    for row in rows:
        gains = row["truth"]["gain_nats"]
        name = row["truth"]["effects"][int(np.argmin(gains))]["name"]
        is_weaker_named.append(name in score.effect_names(row["result"]))
    are_both_named = [
        {e["name"] for e in row["truth"]["effects"]} <= set(score.effect_names(row["result"])) for row in rows
    ]
    has_confident_error = [bool(score.confident_wrong_names(row["result"], row["truth"])) for row in rows]
    mean_jaccard = np.mean([score.jaccard(row["result"], row["truth"]) for row in rows])
    return "\n".join(
        [
            "Pairs: two hidden effects, medium to strong (95 % intervals, exact)",
            f"  both named, nothing else    {_format_score_share(rows, score.is_exact)}",
            f"  both named                  {format_share(are_both_named)}",
            f"  weaker one named            {format_share(is_weaker_named)}",
            f"  wrong, confidence > {score.CONFIDENCE_THRESHOLD}     {format_share(has_confident_error)}",
            f"  Jaccard, mean               {mean_jaccard:.3f}",
            f"  parameters                  {_parameters(rows)}",
        ]
    )


def _open_set(rows: Sequence[Row]) -> str:
    """Return the table of effects outside the vocabulary: counts by kind, and totals with intervals."""
    table_lines = ["Open set: one hidden effect that is outside the vocabulary (95 % intervals, exact)"]
    table_lines.append(
        f"  {'kind, of logs':34s}{'wrong':>12s}{'channel':>9s}{'and dependence':>16s}   confident wrong names"
    )
    for name, group in _group_rows(rows, "name", "variant"):
        has_confident_error, descriptions, name_counts = _score_outside(group)
        most_frequent = ", ".join(f"{wrong_name} ({n})" for wrong_name, n in name_counts.most_common(3))
        counts = [sum(has_confident_error), sum(c for c, _ in descriptions), sum(d for _, d in descriptions)]
        cells = [f"{n}/{len(group)}" for n in counts]
        table_lines.append(
            f"  {name:34s}{cells[0]:>12s}{cells[1]:>9s}{cells[2]:>16s}   {most_frequent or '-'}"
        )
    for strength, group in [*_group_rows(rows, "variant"), ("all", list(rows))]:
        has_confident_error, descriptions, _ = _score_outside(group)
        is_silent = [not row["result"]["found"] and not row["result"]["remaining"] for row in group]
        table_lines.append(f" {strength}, {len(group)} logs")
        table_lines.append(
            f"  wrong, confidence > {score.CONFIDENCE_THRESHOLD}     {format_share(has_confident_error)}"
        )
        table_lines.append(
            f"  described: correct channel  {format_share([channel for channel, _ in descriptions])}"
        )
        table_lines.append(
            f"   and correct dependence     {format_share([dependence for _, dependence in descriptions])}"
        )
        table_lines.append(f"  nothing reported            {format_share(is_silent)}")
    return "\n".join(table_lines)


def _score_outside(rows: Sequence[Row]) -> tuple[list[bool], list[tuple[bool, bool]], Counter[str]]:
    """Return which rows have a confident wrong name, how they describe the effect, and the wrong names."""
    wrong_names = [score.confident_wrong_names(row["result"], row["truth"]) for row in rows]
    descriptions = [score.matches_description(row["result"], row["truth"]) for row in rows]
    return (
        [bool(names) for names in wrong_names],
        descriptions,
        Counter(name for names in wrong_names for name in names),
    )


def _confusable(rows: Sequence[Row]) -> str:
    """Return the table of confusable pairs."""
    table_lines = [
        "Confusable pairs: one effect hidden, on a distinguishable (strong) and on an ambiguous drive (blunt)"
    ]
    for variant, group in _group_rows(rows, "variant"):
        has_confident_error = [
            bool(score.confident_wrong_names(row["result"], row["truth"])) for row in group
        ]
        table_lines.append(f" {variant}, {len(group)} logs")
        table_lines.append(
            f"  named first                 {_format_score_share(group, score.is_named_first)}"
        )
        table_lines.append(
            f"  in the candidate set        {_format_score_share(group, score.is_in_candidate_set)}"
        )
        table_lines.append(
            f"  wrong, confidence > {score.CONFIDENCE_THRESHOLD}     {format_share(has_confident_error)}"
        )
        if variant == "blunt":
            table_lines.append(
                f"  ambiguity admitted          {_format_score_share(group, score.admits_ambiguity)}"
            )
    for name, pair_rows in _group_rows(rows, "name"):
        table_lines.append(
            f" {name}; blunt: {next((r['truth']['why'] for r in pair_rows if r['truth']['why']), '-')}"
        )
        answers_by_truth: dict[tuple[str, str], Counter[str]] = {}
        for row in pair_rows:
            key = row["variant"], row["truth"]["effects"][0]["name"]
            answers_by_truth.setdefault(key, Counter())[lines.format_first_finding(row["result"])] += 1
        for (variant, hidden), answers in answers_by_truth.items():
            counts = ", ".join(f"{n} x {text}" for text, n in answers.most_common())
            table_lines.append(f"  {variant:12s}{hidden:22s} -> {counts}")
    return "\n".join(table_lines)


def _controls(rows: Sequence[Row]) -> str:
    """Return the table of comparisons: wrong names, a black box, permuted temperatures."""
    hidden = [row for row in rows if "oracle" in row]
    table_lines = [
        f"Controls: strong effects, {len(hidden)} logs; reduction of the held-out gap, true effect = 1"
    ]
    if hidden:
        table_lines.append(f"  effects found           {_format_gap_closure(hidden, 'oracle')}")
        for key, label in (("runner_up", "runner-up forced"), ("random", "random name forced")):
            table_lines.append(f"  {label:24s}{_format_gap_closure(hidden, key)}")
        is_gap_larger = [
            row["runner_up"]["held_out_gap"]["after"] > row["result"]["held_out_gap"]["after"]
            for row in hidden
        ]
        table_lines.append(
            f"  runner-up leaves a larger held-out gap than the effects found: {format_share(is_gap_larger)}"
        )
        black_box_rows = [row for row in hidden if "black_box" in row]
        if black_box_rows:
            closures = [
                score.gap_closure(row["black_box"], row["oracle"]["held_out_gap"]) for row in black_box_rows
            ]
            label = _format_closures([value for value in closures if value is not None], len(black_box_rows))
            table_lines.append(f"  regression, no names    {label}")
    permuted_names = [row["permuted"]["found"] for row in hidden if "permuted" in row]
    if permuted_names:
        is_named = ["gyro_temperature" in names for names in permuted_names]
        table_lines.append(
            f"  temperature permuted in blocks, gyro_temperature hidden: named {format_share(is_named)}"
        )
    has_false_alarm = [
        bool(row["result"]["found"]) for row in rows if row["variant"] == "permuted temperature"
    ]
    if has_false_alarm:
        table_lines.append(
            f"  temperature permuted in blocks, nothing hidden: false alarms {format_share(has_false_alarm)}"
        )
    return "\n".join(table_lines)


def _long(rows: Sequence[Row]) -> str:
    """Return the table of long logs."""
    return "\n".join(
        [
            f"Long: {', '.join(sorted({row['name'] + ', ' + row['variant'] for row in rows}))}",
            f"  named, and nothing else     {_format_score_share(rows, score.is_exact)}",
            f"  named first, correct scope  {_format_score_share(rows, score.is_scope_correct)}",
            f"  parameters                  {_parameters(rows)}",
        ]
    )
