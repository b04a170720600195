"""Heading errors against a wrapped truth."""

from types import SimpleNamespace

import numpy as np
import pytest

from hubodo.recording import Table
from hubodo.sensors.heading.score import TrueHeading, read_true_heading, score_heading

T = np.arange(0.0, 100.0)


def track_of(heading):
    return SimpleNamespace(
        t=T, heading=heading, baselines={"raw": heading + 0.01 * T}, sigma=np.full(100, 0.1)
    )


def test_errors_are_relative_to_the_start_and_ignore_full_turns():
    truth = 0.2 * T
    wrapped = np.mod(truth + 1.0, 2.0 * np.pi)
    score = score_heading(track_of(truth + 1e-3 * T), TrueHeading("truth.csv", T, wrapped))
    assert score.errors["heading"].final == pytest.approx(0.099)
    assert score.errors["raw"].largest == pytest.approx(0.099 + 0.99)
    assert score.final_error_in_sigma == pytest.approx(0.99)
    assert score.start == pytest.approx(1.0)


def test_without_two_common_rows_there_is_no_score():
    assert score_heading(track_of(T), TrueHeading("truth.csv", T + 1000.0, T)) is None


def test_the_truth_is_read_from_the_first_file_with_a_heading():
    heading = Table({"t": T, "heading": np.where(T > 50.0, np.nan, T)})
    recording = SimpleNamespace(table=None, truth=Table({"t": T, "x": T, "y": T}), heading=heading)
    truth = read_true_heading(recording)
    assert truth.source == "heading.csv" and len(truth.t) == 51
