"""History of the wheel filter: the steps that can be replayed, and the events that prevent a replay."""

from __future__ import annotations

import numpy as np
import pytest

from hubodo.fuse.wheel.entries import HEADING
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.records import History, MeasurementTerms, StepRecord
from hubodo.fuse.wheel.state_vector import Correction, ExternalCorrection, StateReset, WindowCorrection
from wheel_runs import config, short_loop


def history_of(numbers: range, n_steps: int = 5) -> History:
    """Return a history that holds at most `n_steps` of the steps with these numbers."""
    history = History(n_steps)
    for number in numbers:
        history.append(StepRecord(number, (), (), [], np.empty(0)))
    return history


def test_only_the_newest_steps_can_be_replayed() -> None:
    history = history_of(range(8))
    assert history.is_replayable and history.first_replayable == 3 and history.newest.number == 7
    assert [record.number for record in history.pop_since(5)] == [5, 6, 7]
    assert history.newest.number == 4 and history.first_replayable == 3
    history.append(StepRecord(5, (), (), [], np.empty(0)))
    assert [record.number for record in history.pop_since(0)] == [3, 4, 5]
    assert not history.is_replayable


def test_nothing_before_a_barrier_can_be_replayed() -> None:
    history = history_of(range(4))
    history.set_barrier()
    assert not history.is_replayable and history.pop_since(0) == [] and history.newest.number == 3
    history.append(StepRecord(4, (), (), [], np.empty(0)))
    assert history.first_replayable == 4
    assert [record.number for record in history.pop_since(0)] == [4]


@pytest.mark.parametrize(
    ("kind", "replayable"), [(WindowCorrection, True), (ExternalCorrection, False), (Correction, False)]
)
def test_only_a_window_correction_keeps_the_history_replayable(
    kind: type[Correction], replayable: bool
) -> None:
    core = FilterCore(config(short_loop(1)))
    core.history.append(StepRecord(0, (), (), [], np.empty(0)))
    column = core.columns.vehicle[HEADING]
    h, before = np.eye(len(core.x))[column], (core.x[column], core.p[column, column])
    core.changes = []
    terms = MeasurementTerms.of_row(0.3, h, 0.2 * h, 4.0)
    core.apply(kind(terms))
    assert (core.x[column], core.p[column, column]) == pytest.approx((before[0] + 0.015, before[1] - 0.01))
    assert core.history.is_replayable == replayable
    assert core.changes == [terms]


def test_an_inflation_is_not_replayable_and_no_change_for_smoothing() -> None:
    core = FilterCore(config(short_loop(1)))
    core.history.append(StepRecord(0, (), (), [], np.empty(0)))
    core.changes = []
    core.inflate({HEADING: 0.5})
    assert not core.history.is_replayable and core.changes == []


def test_a_state_reset_ends_the_replayable_history() -> None:
    core = FilterCore(config(short_loop(1)))
    core.history.append(StepRecord(0, (), (), [], np.empty(0)))
    core.apply(StateReset([3, 5]))
    assert not core.history.is_replayable
