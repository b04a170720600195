"""A compass on a vehicle with iron: estimated beside the odometry, left out where disturbed, or rejected."""

import numpy as np
import pytest

from generators import compass
from generators.compass import Iron
from graph_drives import odometry_path, simulate_drive
from hubodo.fuse.graph.batch import fuse_graph
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.heading import Headings
from repetitions import first_and_more


def true_heading(drive, t):
    return np.interp(t, drive.t, drive.heading)


def fuse_with_compass(seed, iron, heading_of=None, start_sigma=2e-3, declared=0.05):
    """Return the drive and its fused track; heading_of: function that changes the compass headings."""
    drive = simulate_drive(seed, length=150.0)
    rng = np.random.default_rng([seed, 73])
    t = np.arange(0.5, drive.t[-1], 0.2)
    shown = compass.headings(rng, t, true_heading(drive, t), iron)
    shown = shown if heading_of is None else heading_of(rng, t, shown)
    config = GraphConfig(start_heading=float(drive.heading[0]), start_heading_sigma=start_sigma)
    headings = Headings(t, shown, np.full(len(t), declared))
    return drive, fuse_graph(odometry_path(drive), None, headings, config)


def heading_errors(drive, result):
    truth = true_heading(drive, result.track.t)
    return np.mod(result.track.heading - truth + np.pi, 2.0 * np.pi) - np.pi


@pytest.mark.parametrize("seeds", first_and_more(range(0, 8, 4), range(8)), ids=str)
def test_iron_is_estimated_and_the_heading_stays_within_its_sigma(seeds):
    """Mean squares of the heading in units of its variance at the end of several drives."""
    squares, without = [], []
    for seed in seeds:
        drive, result = fuse_with_compass(seed, Iron(hard=0.05 + 0.07 * seed, soft=0.1))
        squares.append((heading_errors(drive, result)[-1] / result.track.sigma_heading[-1]) ** 2)
        odometry = (
            drive.odo_heading - drive.odo_heading[0] + drive.heading[0] - true_heading(drive, drive.odo_t)
        )
        without.append((odometry[-1] / result.track.sigma_heading[-1]) ** 2)
    assert np.mean(squares) < 2.0, squares
    assert np.mean(squares) < np.mean(without)


@pytest.mark.parametrize("hard", [0.2, 0.6])
def test_the_size_of_hard_iron_is_reported(hard):
    """The hard iron of the generator is a vector of that length."""
    _, result = fuse_with_compass(3, Iron(hard=hard))
    parts = [result.constants[f"compass_hard_iron_{name}"] for name in ("forward", "left")]
    assert np.hypot(*(part.value for part in parts)) == pytest.approx(hard, abs=0.06)
    (warning,) = result.warnings
    assert "of the field (hard)" in warning
    assert all(0.001 < part.sigma < 0.1 for part in parts)


def test_a_compensated_compass_has_no_warning():
    drive, result = fuse_with_compass(5, Iron())
    assert result.warnings == ()
    assert np.sqrt(np.mean(heading_errors(drive, result) ** 2)) < 0.03


@pytest.mark.parametrize("seed", first_and_more(1, 2, 4))
def test_iron_beside_the_road_does_not_bend_the_track(seed):
    drive, result = fuse_with_compass(seed, Iron(hard=0.1, disturbance=0.5, share=0.25))
    assert np.max(np.abs(heading_errors(drive, result))) < 0.12


@pytest.mark.parametrize(
    ("heading_of", "reason"),
    [
        (lambda rng, t, shown: rng.uniform(-np.pi, np.pi, len(t)), "contradict the gyros|scatter by"),
        (
            lambda rng, t, shown: np.full(len(t), 0.7),
            "contradict the gyros|scatter by|turn differently|would be",
        ),
        (lambda rng, t, shown: -shown, "contradict the gyros|scatter by|turn differently|would be"),
        (lambda rng, t, shown: shown + 0.02 * t, "scatter by|turn differently|contradict the others"),
    ],
)
def test_headings_that_are_none_are_not_used(heading_of, reason):
    """Noise, a stuck compass, one that counts clockwise, one that drifts by a degree per second."""
    drive, result = fuse_with_compass(7, Iron(), heading_of)
    (warning,) = [text for text in result.warnings if text.startswith("compass")]
    assert "its headings are not used" in warning
    assert any(part in warning for part in reason.split("|")), warning
    plain = fuse_graph(
        odometry_path(drive),
        None,
        None,
        GraphConfig(start_heading=float(drive.heading[0]), start_heading_sigma=2e-3),
    )
    assert result.track.heading == pytest.approx(plain.track.heading)


def test_without_another_start_the_track_of_a_rejected_compass_starts_at_the_odometry():
    drive = simulate_drive(7, length=150.0)
    t = np.arange(0.5, drive.t[-1], 0.2)
    noise = np.random.default_rng(8).uniform(-np.pi, np.pi, len(t))
    result = fuse_graph(odometry_path(drive), None, Headings(t, noise))
    assert result.track.heading[0] == pytest.approx(drive.odo_heading[0], abs=1e-6)


@pytest.mark.parametrize("seeds", first_and_more(range(2), range(2, 6)), ids=str)
def test_a_field_beside_the_road_is_named_and_left_out(seeds):
    """The disturbed span, 30 % of the drive, is found within 4 s of the generator's."""
    for seed in seeds:
        iron = Iron(hard=0.3, disturbance=0.5, share=0.3)
        drive, result = fuse_with_compass(seed, iron)
        rng = np.random.default_rng([seed, 73])
        last = np.arange(0.5, drive.t[-1], 0.2)[-1]
        start, direction = rng.uniform(0.1, 0.6) * last, rng.uniform(-np.pi, np.pi)
        if abs(np.cos(direction)) < 0.4:
            continue  # A field parallel to the Earth's own changes no heading.
        (line,) = [text for text in result.warnings if "beside the road" in text]
        shown = [float(word) for word in line.split("headings, ")[1].split(" s;")[0].split(" to ")]
        assert shown == pytest.approx([start, start + 0.3 * last], abs=4.0), (seed, line)


@pytest.mark.parametrize("seeds", first_and_more(range(23, 30, 6), range(20, 30)), ids=str)
def test_no_span_of_an_undisturbed_field_is_left_out(seeds):
    """No span is left out of several drives with iron of the vehicle up to 36 %."""
    for seed in seeds:
        _, result = fuse_with_compass(seed, Iron(hard=0.04 * (seed - 20), soft=0.05))
        assert not any("beside the road" in text for text in result.warnings), seed


def test_errors_that_last_for_seconds_are_in_the_sigma_of_a_compass_declared_with_its_true_noise():
    """Loops with 5 % of hard iron: the NEES of the heading was 1.7 with a shorter correlation."""
    squares = []
    for seed in range(30, 36):
        drive, result = fuse_with_compass(seed, Iron(hard=0.05), declared=0.028)
        squares.append((heading_errors(drive, result)[-1] / result.track.sigma_heading[-1]) ** 2)
    assert np.mean(squares) < 1.2
