"""Removal of rows that no sensor can have measured."""

import numpy as np

from hubodo.log.row_checks import drop_implausible_rows, drop_non_finite_rows
from hubodo.recording import NODE_COLUMNS, Table


def node(**columns):
    return Table({**{name: np.arange(4.0) for name in NODE_COLUMNS}, **columns})


def test_rows_with_nan_in_a_required_column_are_dropped_and_nan_in_others_is_allowed():
    nan, bad = np.array([np.nan, 1, 2, 3]), np.array([0, 1, np.inf, 3])
    tables, notes = drop_non_finite_rows({"left": node(gz=bad, temperature=nan), "right": node()})
    assert tables["left"].t.tolist() == [0, 1, 3] and np.isnan(tables["left"]["temperature"][0])
    assert len(tables["right"]) == 4
    assert notes == ["left: 1 of 4 rows hold NaN or infinity, first at t = 2.000 s; left out"]


def test_a_table_without_a_required_column_or_a_finite_row_is_dropped():
    incomplete = Table({"t": np.arange(2.0), "gx": np.arange(2.0)})
    missing = np.full(4, np.nan)
    tables, notes = drop_non_finite_rows(
        {"left": incomplete, "right": node(gx=missing, gy=missing, gz=missing)}
    )
    assert tables == {} and "gy, gz, ax, ay, az are missing" in notes[0] and "4 of 4 rows" in notes[1]


def test_a_node_without_an_accelerometer_is_dropped_only_beside_a_complete_one():
    gyro_only = node(ax=np.full(4, np.nan), gy=np.array([0, np.nan, 2, 3]))
    tables, notes = drop_non_finite_rows({"left": gyro_only})
    assert tables["left"].t.tolist() == [0, 2, 3] and "1 of 4 rows" in notes[0]
    tables, notes = drop_non_finite_rows({"left": gyro_only, "right": node()})
    assert list(tables) == ["right"] and "4 of 4 rows" in notes[0]


def test_implausibly_large_values_are_dropped_but_not_large_times():
    t = np.array([1e15, 2e15, 3e15, 4e15])
    tables, notes = drop_implausible_rows({"left": node(t=t, az=np.array([0, -1e13, 1e11, 0]))})
    assert tables["left"].t.tolist() == [1e15, 3e15, 4e15] and "1 rows hold numbers too large" in notes[0]
