"""Rows of results as text: one line per result, and each failure in detail."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gap_matrix.judge import score

Row = dict[str, Any]


def format_result(result: Any) -> str:
    """Return a result as one line."""
    findings = [
        f"{finding['effect']} ({finding['scope']}) {finding['confidence']:.3g}"
        + (f" = {'/'.join(finding['inseparable_from'])}" if finding["inseparable_from"] else "")
        for finding in result["found"]
    ]
    return f"{result['verdict']}: {', '.join(findings) or 'nothing'}"


def format_row(row: Row) -> str:
    """Return a row as one line."""
    text = row.get("unmade") or (
        row["error"].splitlines()[-1] if "error" in row else format_result(row["result"])
    )
    return f"{'ok' if is_correct(row) else '!!'} {row['key']} -> {text}"


def is_correct(row: Row) -> bool:
    """Return True if the result of a row is as expected for its table."""
    if "result" not in row or "error" in row:
        return False
    result, truth = row["result"], row["truth"]
    match row["table"]:
        case "open":
            return not score.confident_wrong_names(result, truth) and all(
                score.matches_description(result, truth)
            )
        case "nulls":
            return result["verdict"] == "no_gap"
        case "alike" if row["variant"] == "blunt":
            return score.admits_ambiguity(result, truth)
        case "singles" if row["variant"] == "faint" and not result["found"]:
            return True
        case _:
            return score.is_exact(result, truth)


def format_failures(rows: Sequence[Row]) -> str:
    """Return the details of rows with a wrong name or a parameter off by more than 3 sigma."""
    return "\n".join(_format_failure(row) for row in rows if not is_correct(row) or _large_errors(row))


def _large_errors(row: Row) -> list[float]:
    """Return the parameter errors above 3 sigma, in sigma."""
    return [z for z in score.parameter_errors(row["result"], row["truth"])[0] if abs(z) > 3]


def _format_failure(row: Row) -> str:
    """Return the details of one row."""
    lines = [format_row(row)]
    if is_correct(row):
        lines.append(f"    parameters off by {', '.join(f'{z:.1f}' for z in _large_errors(row))} sigma")
    if "truth" in row:
        lines.append(f"    truth {row['truth']}")
    for finding in row.get("result", {}).get("found", []):
        values = {key: (it["value"], it["sigma"]) for key, it in finding["parameters"].items()}
        lines.append(f"    found {finding['effect']} {finding['scope']} {values}")
        lines.append(f"        where {finding['where']}")
        lines.append(f"        runner-up {finding['runner_up']}; held out {finding['held_out_gap']}")
    for residual in row.get("result", {}).get("remaining", []):
        lines.append(f"    remaining {residual['channel']}: {residual['where']}; {residual['looks_like']}")
    if "error" in row:
        lines.append(row["error"])
    return "\n".join(lines)


def format_first_finding(result: Any) -> str:
    """Return the first name with its inseparable alternatives, doubt and the number of further findings."""
    if not result["found"]:
        return "nothing"
    first = result["found"][0]
    alternatives = " = ".join(["", *first["inseparable_from"]]) + (
        "" if first["confidence"] > score.CONFIDENCE_THRESHOLD else " (unsure)"
    )
    n_others = len(result["found"]) - 1
    return first["effect"] + alternatives + (f" and {n_others} more" if n_others else "")
