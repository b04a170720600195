"""Effects that `gap` finds missing in each vehicle, since when, with a bounded false discovery rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from hubodo.fleet.quantities import MISSING_EFFECT_PREFIX
from hubodo.fleet.spread import benjamini_hochberg

MAX_FALSE_EFFECT_SHARE = 0.05
"""Maximum expected share of false discoveries among the effects reported as missing."""
GAP_VERB = "gap"


@dataclass(frozen=True)
class MissingEffect:
    """An effect that the model of a vehicle lacks.

    Attributes
    ----------
    scope : node, `all` or `vehicle`.
    logs, examined_logs : number of logs in which it is significant, and of all that `gap` examined.
    since : Monday of the first week since which most logs of every week have it; None if intermittent.
    """

    effect: str
    scope: str
    vehicle: str
    logs: int
    examined_logs: int
    since: pd.Timestamp | None


def add_q_values(table: pd.DataFrame) -> pd.DataFrame:
    """Return the table with the `q_value` of each effect found, over all logs that `gap` examined.

    Each log contributes one test for each effect found and one unsuccessful test, which counts with p = 1.
    """
    examined = table[(table.verb == GAP_VERB) & (table.status == "done")]
    effects = examined[examined.p_value.notna()]
    null_p_values = np.ones(examined.log.nunique())
    q = benjamini_hochberg(np.concatenate([effects.p_value.to_numpy(float), null_p_values]))
    result = table.assign(q_value=np.nan)
    result.loc[effects.index, "q_value"] = q[: len(effects)]
    return result


def significant_effects(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of significant effects, with `effect` and `week` (its Monday)."""
    effects = table[table.q_value <= MAX_FALSE_EFFECT_SHARE]
    return effects.assign(
        effect=effects.quantity.str.removeprefix(MISSING_EFFECT_PREFIX), week=_monday_of(effects.start)
    )


def list_missing_effects(table: pd.DataFrame) -> list[MissingEffect]:
    """Return the missing effects by effect and vehicle, the most widespread effect first."""
    done = table[(table.verb == GAP_VERB) & (table.status == "done")].drop_duplicates("log")
    examined = done.assign(week=_monday_of(done.start))
    effects = []
    for (effect, scope, vehicle), group in significant_effects(table).groupby(["effect", "node", "vehicle"]):
        of_vehicle = examined[examined.vehicle == vehicle]
        effects.append(
            MissingEffect(
                effect,
                scope,
                vehicle,
                group.log.nunique(),
                len(of_vehicle),
                _first_persistent_week(group, of_vehicle),
            )
        )
    n_vehicles = {one.effect: 0 for one in effects}
    for one in effects:
        n_vehicles[one.effect] += 1
    return sorted(
        effects, key=lambda one: (-n_vehicles[one.effect], one.effect, one.scope, -one.logs, one.vehicle)
    )


def weekly_shares(table: pd.DataFrame, effect: str) -> pd.DataFrame:
    """Return the share of logs with the effect by vehicle (row) and week (column); NaN without logs."""
    done = table[(table.verb == GAP_VERB) & (table.status == "done")].drop_duplicates("log")
    examined = done.assign(week=_monday_of(done.start)).groupby(["vehicle", "week"]).log.nunique()
    rows = significant_effects(table)
    with_effect = rows[rows.effect == effect].groupby(["vehicle", "week"]).log.nunique()
    share = (with_effect.reindex(examined.index, fill_value=0) / examined).unstack("week")
    all_weeks = (
        pd.date_range(share.columns.min(), share.columns.max(), freq="7D") if len(share.columns) else []
    )
    return share.reindex(columns=all_weeks)


def _first_persistent_week(with_effect: pd.DataFrame, examined: pd.DataFrame) -> pd.Timestamp | None:
    """Return the first week of the unbroken run, up to the last week, in which most logs have the effect."""
    share = (with_effect.groupby("week").log.nunique() / examined.groupby("week").log.nunique()).fillna(0.0)
    since = None
    for week, part in share.sort_index(ascending=False).items():
        if part <= 0.5:
            break
        since = week
    return since


def _monday_of(start: pd.Series) -> pd.Series:
    """Return the Monday of the week of each time."""
    days = start.dt.tz_localize(None).dt.normalize()
    return days - pd.to_timedelta(days.dt.day_of_week, unit="D")
