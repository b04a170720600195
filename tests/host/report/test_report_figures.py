"""Data of figures and texts of pages: bins, envelopes, formats, and files of a gap result."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.gap.explain.figures import bin_means, envelope
from hubodo.gap.explain.files import check_gap_folder
from hubodo.pages.curves import Curve, plot_curves
from hubodo.safe_text import json_value
from hubodo.sensors.allan.page import TERM_MEANINGS, format_duration, format_value
from hubodo.sensors.north.page import count_decimals, summarise_north
from hubodo.sensors.north.result import NorthResult


def test_the_envelope_contains_all_values():
    values = np.random.default_rng(4).normal(size=10_000)
    t, low, mean, high = envelope(np.arange(10_000.0), values)
    assert len(t) == 500 and low.min() == pytest.approx(values.min(), abs=1e-3)
    assert np.all(low <= mean) and np.all(mean <= high)
    assert high.max() == pytest.approx(values.max(), abs=1e-3)


def test_bin_means_follow_the_dependence():
    x = np.random.default_rng(5).uniform(0.0, 1.0, 30_000)
    centre, mean, error = bin_means(x, 3.0 * x)
    assert mean == pytest.approx(3.0 * centre, abs=0.01) and np.all(error > 0.0)


@pytest.mark.parametrize(
    "seconds, text", [(30.0, "30 s"), (600.0, "10 min"), (9000.0, "2.5 h"), (3e5, "3.47 days")]
)
def test_durations_are_given_in_a_suitable_unit(seconds, text):
    assert format_duration(seconds) == text


def test_values_are_given_with_their_unit():
    assert format_value(1.23456e-4, "rad/s") == "0.0001235 rad/s"
    assert "white noise" in TERM_MEANINGS["N"]


@pytest.mark.parametrize(
    ("other_deg", "gyros", "text"),
    [
        (None, 1, "350.00° ± 0.50°"),
        (190.0, 1, "either 350.00° or 190.00°, each ± 0.50°"),
        (190.0, 2, "350.00° ± 0.50°"),  # two axes decide together
    ],
)
def test_the_summary_of_north_states_both_azimuths_if_the_record_allows_two(other_deg, gyros, text):
    other = None if other_deg is None else np.radians(other_deg)
    north = NorthResult(
        48.0, np.radians(-10.0), np.radians(0.5), (SimpleNamespace(other_azimuth=other),) * gyros, (), {}
    )
    assert summarise_north(north) == f"Table zero points {text} (1σ) clockwise from north."


@pytest.mark.parametrize(
    ("sigma_deg", "decimals"), [(19.9, 0), (1.34, 1), (0.134, 2), (0.0021, 3), (math.inf, 0)]
)
def test_a_sigma_is_given_with_two_digits_at_most(sigma_deg, decimals):
    assert count_decimals(math.radians(sigma_deg)) == decimals


def test_non_finite_numbers_are_null():
    assert json_value({"a": [1.0, float("nan")], "b": float("inf")}) == {"a": [1.0, None], "b": None}


def test_a_folder_with_another_model_is_refused(tmp_path):
    (tmp_path / "model.toml").write_text("")
    with pytest.raises(InputError, match="not a result of gap"):
        check_gap_folder(tmp_path, None)
    with pytest.raises(InputError, match="is the input model"):
        check_gap_folder(tmp_path, tmp_path / "model.toml")
    (tmp_path / "gap.json").write_text("{}")
    check_gap_folder(tmp_path, None)


def test_a_scale_from_zero_has_room_above_and_numbered_items_have_whole_ticks():
    number = np.arange(1, 20)
    (axes,) = plot_curves(
        [Curve(number, 0.01 * number + 416.0, "a", "#000000")], "n", "Hz", from_zero=True
    ).axes
    assert axes.get_ylim()[0] == 0.0 and axes.get_ylim()[1] > 1.02 * 416.0
    assert np.all(axes.get_xticks() % 1 == 0)
    (axes,) = plot_curves([Curve(0.1 * number, number, "a", "#000000")], "t", "a").axes
    assert np.any(axes.get_xticks() % 1 != 0)


def test_a_second_axis_and_a_band_are_plotted():
    t = np.arange(10.0)
    figure = plot_curves(
        [Curve(t, t, "a", "#000000", sigma=t)], "t", "a", right=("b", [Curve(t, -t, "b", "#111111")])
    )
    assert [axes.get_ylabel() for axes in figure.axes] == ["a", "b"]
    assert len(figure.axes[0].collections) == 1
