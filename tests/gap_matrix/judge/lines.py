"""Rows of results as text: one line per result, and each failure in detail."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gap_matrix.judge import score

Row = dict[str, Any]


def answer(result: Any) -> str:
    """Return a result as one line."""
    found = [
        f"{it['effect']} ({it['scope']}) {it['confidence']:.3g}"
        + (f" = {'/'.join(it['inseparable_from'])}" if it["inseparable_from"] else "")
        for it in result["found"]
    ]
    return f"{result['verdict']}: {', '.join(found) or 'nothing'}"


def line(row: Row) -> str:
    """Return a row as one line."""
    text = row.get("unmade") or (row["error"].splitlines()[-1] if "error" in row else answer(row["result"]))
    return f"{'ok' if right(row) else '!!'} {row['key']} -> {text}"


def right(row: Row) -> bool:
    """Return True if a row needs no attention."""
    if "result" not in row or "error" in row:
        return False
    result, truth = row["result"], row["truth"]
    match row["table"]:
        case "open":
            return not score.sure_and_wrong(result, truth) and all(score.described(result, truth))
        case "nulls":
            return result["verdict"] == "no_gap"
        case "alike" if row["variant"] == "blunt":
            return score.admits_doubt(result, truth)
        case "singles" if row["variant"] == "faint" and not result["found"]:
            return True
        case _:
            return score.exact(result, truth)


def failures(rows: Sequence[Row]) -> str:
    """Return the details of rows with a wrong name or a parameter off by more than 3 sigma."""
    return "\n".join(_failure(row) for row in rows if not right(row) or _off(row))


def _off(row: Row) -> list[float]:
    return [z for z in score.deviations(row["result"], row["truth"])[0] if abs(z) > 3]


def _failure(row: Row) -> str:
    out = [line(row)]
    if right(row):
        out.append(f"    parameters off by {', '.join(f'{z:.1f}' for z in _off(row))} sigma")
    if "truth" in row:
        out.append(f"    truth {row['truth']}")
    for found in row.get("result", {}).get("found", []):
        values = {key: (it["value"], it["sigma"]) for key, it in found["parameters"].items()}
        out.append(f"    found {found['effect']} {found['scope']} {values}")
        out.append(f"        where {found['where']}")
        out.append(f"        runner-up {found['runner_up']}; held out {found['held_out_gap']}")
    for left in row.get("result", {}).get("remaining", []):
        out.append(f"    remaining {left['channel']}: {left['where']}; {left['looks_like']}")
    if "error" in row:
        out.append(row["error"])
    return "\n".join(out)


def head_of(result: Any) -> str:
    """Return the first name with its confidence and the number of others."""
    if not result["found"]:
        return "nothing"
    head = result["found"][0]
    doubt = " = ".join(["", *head["inseparable_from"]]) + (
        "" if head["confidence"] > score.SURE else " (unsure)"
    )
    more = len(result["found"]) - 1
    return head["effect"] + doubt + (f" and {more} more" if more else "")
