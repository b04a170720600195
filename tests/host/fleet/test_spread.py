"""Outliers, drifts and missing effects of a fleet, in generated tables with fixed seeds."""

import re

import numpy as np
import pandas as pd
import pytest

from hubodo.fleet.missing_effects import add_q_values, list_missing_effects, weekly_shares
from hubodo.fleet.page import build_fleet_page
from hubodo.fleet.spread import benjamini_hochberg, find_drifts, find_outliers, normalised_deviations

MONDAY = pd.Timestamp("2026-06-01", tz="UTC")
VEHICLES, WEEKS = 20, 26


LOG = {
    "verb": "allan",
    "vehicle": "van-1",
    "start": MONDAY,
    "status": "done",
    "error": None,
    "size": 1,
    "cpu": 1.0,
    "node": "left",
    "quantity": "gz.N",
    "value": 1.0,
    "sigma": np.nan,
    "unit": "",
    "p_value": np.nan,
}


def rows(number, **columns):
    """Return a table of `number` logs with columns as in table.parquet."""
    return pd.DataFrame({"log": [f"/logs/{k}.mcap" for k in range(number)], **LOG, **columns})


def test_q_values_follow_the_definition_of_benjamini_and_hochberg():
    p = np.random.default_rng(3).uniform(size=40) ** 3
    order = np.argsort(p)
    by_hand = np.empty(40)
    for rank, index in enumerate(order):
        by_hand[index] = min(1.0, min(40 * p[order[later]] / (later + 1) for later in range(rank, 40)))
    assert benjamini_hochberg(p) == pytest.approx(by_hand)


def test_normal_logs_are_seldom_outliers_and_a_deviating_one_always_is():
    rng = np.random.default_rng(7)
    named = 0
    for _ in range(100):
        values = np.exp(rng.normal(-8.0, 0.1, 300))
        values[17] = np.exp(-8.0 + 0.1 * 8.0)
        outliers = find_outliers(rows(300, value=values))
        assert outliers.log.iloc[0] == "/logs/17.mcap"
        named += len(outliers) - 1
    assert named <= 10


def test_deviating_counts_and_values_are_outliers_despite_logs_with_large_sigmas():
    counts = np.zeros(100)
    counts[3] = 7.0
    assert list(np.flatnonzero(normalised_deviations(counts, np.full(100, np.nan)))) == [3]
    page = build_fleet_page(rows(100, verb="info", quantity="gaps", value=counts))
    assert "all others are equal" in page and "inf" not in page.replace("info", "")
    values, sigmas = np.random.default_rng(1).normal(0.0, 1.0, 100), np.full(100, 0.1)
    values[5], sigmas[5] = 30.0, 20.0
    assert abs(normalised_deviations(values, sigmas)[5]) < 2.0
    assert np.isnan(normalised_deviations(values[:4], sigmas[:4])).all()


def test_a_drifting_bias_is_reported_with_its_slope_and_a_scattering_one_is_not():
    rng = np.random.default_rng(5)
    starts = [MONDAY + pd.Timedelta(weeks=k) for k in range(WEEKS)]
    tables = [
        rows(
            WEEKS,
            verb="info",
            vehicle=f"van-{v}",
            start=starts,
            quantity="bias.z",
            value=rng.normal(0.01, 1e-3, WEEKS) + (3e-4 * np.arange(WEEKS) if v == 4 else 0.0),
        )
        for v in range(VEHICLES)
    ]
    drifts = [one for one in find_drifts(pd.concat(tables, ignore_index=True)) if one.vehicle == "van-4"]
    assert len(drifts) == 1 and drifts[0].low < 3e-4 < drifts[0].high and drifts[0].weeks == WEEKS
    assert len(find_drifts(pd.concat(tables, ignore_index=True))) <= 2


def gap_table(rng, p_of):
    """Return one log per vehicle and week; p_of: p-value of its best effect, reported if below 0.01."""
    table_rows = []
    for vehicle, week in np.ndindex(VEHICLES, WEEKS):
        start = MONDAY + pd.Timedelta(weeks=week, days=float(rng.uniform(0, 6)))
        log = {**LOG, "verb": "gap", "log": f"/{vehicle}/{week}", "vehicle": f"van-{vehicle}", "start": start}
        table_rows.append({**log, "node": "", "quantity": "gap.before"})
        effect, p = p_of(vehicle, week)
        if p < 0.01:
            table_rows.append({**log, "quantity": f"found.{effect}", "p_value": p, "value": 0.99})
    return add_q_values(pd.DataFrame(table_rows))


def test_the_false_discovery_rate_across_logs_is_at_most_5_percent():
    rng = np.random.default_rng(11)
    chance = believed = 0
    for _ in range(20):
        real = {(v, w) for v in range(3) for w in range(WEEKS)}

        def p_of(vehicle, week, real=real):
            sound = rng.uniform()
            return ("wheel_camber", 1e-8) if (vehicle, week) in real else ("gyro_bias", sound)

        effects = list_missing_effects(gap_table(rng, p_of))
        chance += sum(one.logs for one in effects if one.effect == "gyro_bias")
        believed += sum(one.logs for one in effects)
    assert believed >= 20 * 3 * WEEKS
    assert chance / believed < 0.05


def test_a_missing_effect_is_listed_with_its_vehicles_and_its_first_week():
    rng = np.random.default_rng(2)

    def p_of(vehicle, week):
        if vehicle == 2 and week >= 9:
            return "wheel_camber", 1e-9
        return ("wheel_radius", 1e-9) if vehicle == 5 and week in (1, 20) else ("", 1.0)

    table = gap_table(rng, p_of)
    effects = {one.effect: one for one in list_missing_effects(table)}
    camber, radius = effects["wheel_camber"], effects["wheel_radius"]
    assert (camber.vehicle, camber.logs, camber.examined_logs) == ("van-2", WEEKS - 9, WEEKS)
    assert camber.since == pd.Timestamp("2026-06-01") + pd.Timedelta(weeks=9)
    assert (radius.vehicle, radius.logs, radius.since) == ("van-5", 2, None)
    share = weekly_shares(table, "wheel_camber")
    assert share.shape == (VEHICLES, WEEKS)
    assert share.loc["van-2"].tolist() == [0.0] * 9 + [1.0] * (WEEKS - 9)
    page = build_fleet_page(table)
    assert "wheel_camber in 1, wheel_radius in 1" in page and page.count('class="on-wide"') >= 2
    cells = re.sub("<td[^>]*>", "<td>", page)
    assert f"<td>{WEEKS - 9} of {WEEKS}</td><td>2026-08-03</td>" in cells
    assert f"<td>2 of {WEEKS}</td><td></td>" in cells


def test_drives_have_a_table_with_units_and_few_values_no_figure():
    table = rows(4, verb="fuse", quantity="distance", unit="m", value=[10.0, 20.0, 30.0, 40.0])
    page = build_fleet_page(table)
    assert "<h2>Drives</h2>" in page and "distance, m" in page and "40.000" in page
    assert "<svg" not in page
