"""Which effects `gap` finds missing in which vehicles, since when, and how many of them are chance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from hubodo.fleet.quantities import FOUND
from hubodo.fleet.spread import adjusted

FALSE_SHARE = 0.05
"""Of all effects believed to be missing in a log so many are chance, at the most, on average."""
VERB = "gap"


@dataclass(frozen=True)
class Missing:
    """An effect that a vehicle's model lacks. scope: node, `all` or `vehicle`.

    logs: in how many of `of` it is believed. since: the Monday of the week from which on it is in most logs
    of each week that has some; None where it comes and goes.
    """

    effect: str
    scope: str
    vehicle: str
    logs: int
    of: int
    since: pd.Timestamp | None


def with_q_values(table: pd.DataFrame) -> pd.DataFrame:
    """The table with `q_value` of each effect found, over all logs that `gap` examined.

    A log was asked once for each effect found and once more, in vain: that question counts with a p value
    of 1.
    """
    asked = table[(table.verb == VERB) & (table.status == "done")]
    found = asked[asked.p_value.notna()]
    vain = np.ones(asked.log.nunique())
    q = adjusted(np.concatenate([found.p_value.to_numpy(float), vain]))
    made = table.assign(q_value=np.nan)
    made.loc[found.index, "q_value"] = q[: len(found)]
    return made


def believed(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of effects found that stand up across logs, with `effect` and `week` (its Monday)."""
    found = table[table.q_value <= FALSE_SHARE]
    return found.assign(effect=found.quantity.str.removeprefix(FOUND), week=_week(found.start))


def missing_effects(table: pd.DataFrame) -> list[Missing]:
    """By effect and vehicle, the most widespread first."""
    done = table[(table.verb == VERB) & (table.status == "done")].drop_duplicates("log")
    asked = done.assign(week=_week(done.start))
    found = []
    for (effect, scope, vehicle), group in believed(table).groupby(["effect", "node", "vehicle"]):
        own = asked[asked.vehicle == vehicle]
        found.append(Missing(effect, scope, vehicle, group.log.nunique(), len(own), _since(group, own)))
    spread = {one.effect: 0 for one in found}
    for one in found:
        spread[one.effect] += 1
    return sorted(found, key=lambda one: (-spread[one.effect], one.effect, one.scope, -one.logs, one.vehicle))


def shares(table: pd.DataFrame, effect: str) -> pd.DataFrame:
    """Of the logs of each vehicle (row) and week (column) the share in which the effect is; NaN: no log."""
    done = table[(table.verb == VERB) & (table.status == "done")].drop_duplicates("log")
    asked = done.assign(week=_week(done.start)).groupby(["vehicle", "week"]).log.nunique()
    rows = believed(table)
    found = rows[rows.effect == effect].groupby(["vehicle", "week"]).log.nunique()
    share = (found.reindex(asked.index, fill_value=0) / asked).unstack("week")
    every = pd.date_range(share.columns.min(), share.columns.max(), freq="7D") if len(share.columns) else []
    return share.reindex(columns=every)


def _since(found: pd.DataFrame, asked: pd.DataFrame) -> pd.Timestamp | None:
    """The first week of the run of weeks, up to the last, in most logs of which it is."""
    share = (found.groupby("week").log.nunique() / asked.groupby("week").log.nunique()).fillna(0.0)
    since = None
    for week, part in share.sort_index(ascending=False).items():
        if part <= 0.5:
            break
        since = week
    return since


def _week(start: pd.Series) -> pd.Series:
    """The Monday of each."""
    days = start.dt.tz_localize(None).dt.normalize()
    return days - pd.to_timedelta(days.dt.day_of_week, unit="D")
