"""The comparison of filters on drives by an independent generator, with the true rate as the oracle."""

import math

import numpy as np
import pytest

from generators import spin_drives
from hubodo.errors import InputError
from hubodo.recording import Recording, Table
from hubodo.sensors.filters.bias import estimate_static_biases
from hubodo.sensors.filters.compare import compare_filters

DT, NOISE, RADIUS = 0.01, 0.1, spin_drives.RADIUS
SEED = 3


def recorded(noise=NOISE, seed=SEED, duration=60.0):
    """Return a drive, and its log: gyro on z, wheel speed at 50 Hz, 40 ms late and 1 % too large."""
    rng = np.random.default_rng(seed)
    rate = spin_drives.wheel_rate(rng, duration, DT)
    drive = spin_drives.sensed(rng, rate, DT, noise=noise)
    gyro = noise * rng.standard_normal((len(rate), 2)) + [0.01, -0.02]
    node = {"t": drive.t, "gx": gyro[:, 0], "gy": gyro[:, 1], "gz": drive.z}
    node |= {name: np.full(len(rate), np.nan) for name in ("ax", "ay", "az")}
    wheels = Table({"t": drive.t[::2] + 0.04, "left": 1.01 * RADIUS * rate[::2], "right": rate[::2]})
    return drive, Recording({"left": Table(node)}, wheels=wheels)


@pytest.fixture(scope="module")
def drive_and_result():
    drive, recording = recorded()
    return drive, compare_filters(recording, "left", "gz", reference="wheels", standstills=[(0.0, 17.0)])


def by_kind(result):
    return {score.candidate.name: score for score in result.scores}


def test_delay_and_scale_of_the_reference_are_those_injected(drive_and_result):
    drive, result = drive_and_result
    assert result.reference.name == "wheels.left"
    assert result.reference.delay == pytest.approx(0.04, abs=3e-3)
    assert result.reference.scale == pytest.approx(1.0 / (1.01 * RADIUS), rel=3e-3)
    known = np.isfinite(result.truth)
    error = result.truth[known] - drive.rate[known]
    assert float(np.sqrt(np.mean(error**2))) < 0.03, "rad/s; a tenth of the noise"


def test_errors_are_those_against_the_true_rate(drive_and_result):
    """Each stated error is that against the generator's rate, within the error of the reference."""
    drive, result = drive_and_result
    half = len(drive.t) // 2
    for score in result.scores:
        true_error = np.sqrt(np.mean((score.rates - drive.rate)[half:-1] ** 2))
        assert score.error == pytest.approx(true_error, rel=0.06), score.candidate.name


def test_the_chosen_constants_are_close_to_the_best_for_the_second_half(drive_and_result):
    """A fine search that uses the truth of the second half gains at most 10 % more."""
    drive, result = drive_and_result
    half = len(drive.t) // 2
    bias = drive.z[:1700].mean()

    def smoothed_error(gain):
        rate, total = 0.0, 0.0
        for k, (z, truth) in enumerate(zip(drive.z.tolist(), drive.rate.tolist(), strict=True)):
            rate += gain * (z - bias - rate)
            total += (rate - truth) ** 2 * (k >= half)
        return math.sqrt(total / half)

    best = min(map(smoothed_error, np.geomspace(0.02, 0.8, 25)))
    assert by_kind(result)["Kalman"].error < 1.1 * best


def test_the_delay_of_a_moving_average_is_half_its_width(drive_and_result):
    _, result = drive_and_result
    score = by_kind(result)["moving average"]
    width = score.candidate.constants["width_samples"]
    assert score.delay == pytest.approx(0.5 * (width - 1) * DT, abs=0.3 * DT)


def test_the_filter_of_the_node_that_wins_is_recommended_with_its_settings(drive_and_result):
    _, result = drive_and_result
    scores = by_kind(result)
    assert result.chosen is scores["Kalman"]
    gain = scores["Kalman"].candidate.constants["rate_gain"]
    assert result.settings["filter_kind"] == 1
    assert result.settings["gain_rate_q20"] == round(gain * 2**20)
    assert f"--set gain_rate_q20={result.settings['gain_rate_q20']}" in result.recommendation


def test_the_settings_are_within_the_bounds_of_the_firmware(drive_and_result):
    _, result = drive_and_result
    bounds = {"filter_kind": (0, 2), "forgetting_q20": (2**19, 2**20 - 1024)}
    for score in result.scores:
        for name, value in (score.candidate.settings or {}).items():
            low, high = bounds.get(name, (0, 2**20 - 1))
            assert low <= value <= high, name


def test_quiet_samples_stay_raw():
    """A filter gains nothing on a wheel that accelerates, with the noise of a real chip."""
    _, recording = recorded(noise=1e-5)
    result = compare_filters(recording, "left", "gz", reference="wheels", standstills=[(0.0, 17.0)])
    assert result.chosen.candidate.kind == "raw"


def test_the_bias_is_covered_by_its_sigma_over_seeds():
    """40 seeds, standstill only: errors in units of sigma have unit spread (mean of 8 blocks: t, 7 dof)."""
    ratios = {"mean": [], "pseudo-measurement": []}
    for seed in range(40):
        rng = np.random.default_rng(seed)
        truth = rng.normal(0.0, 0.02, 3)
        gyro = truth + 9e-4 * rng.standard_normal((4000, 3))
        for it in estimate_static_biases(gyro, 2, ((0, 4000),)):
            ratios[it.method].append((it.bias - truth[2]) / it.sigma)
    for method, values in ratios.items():
        assert 0.75 < float(np.std(values)) < 1.5, method


def test_a_standstill_alone_recommends_nothing():
    rng = np.random.default_rng(1)
    columns = {name: 1e-3 * rng.standard_normal(2000) for name in ("gx", "gy", "gz", "ax", "ay")}
    columns |= {"t": np.arange(2000) * DT, "az": 9.81 + 0.01 * rng.standard_normal(2000)}
    result = compare_filters(Recording({"left": Table(columns)}), "left", "gz")
    assert result.chosen is None and result.settings is None
    assert all(score.delay is None for score in result.scores)
    assert any("record a drive" in note for note in result.notes)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"reference": "table"}, "--reference table: the log has wheels"),
        ({"reference": "wheels.middle"}, "name the column: wheels.left, wheels.right"),
        ({"start": 1e4}, "they are from 0 to"),
        ({"standstills": [(900.0, 901.0)]}, "--rest 900 901: holds 0 samples"),
        ({"start": 39.0}, "are too few"),
    ],
)
def test_what_does_not_fit_is_refused_by_the_name_of_the_option(options, message):
    _, recording = recorded(duration=40.0)
    with pytest.raises(InputError, match=message):
        compare_filters(recording, "left", "gz", **options)


def test_an_unmeasured_axis_and_a_foreign_reference_are_refused():
    drive, recording = recorded(duration=40.0)
    rng = np.random.default_rng(2)
    foreign = Table({"t": drive.t, "left": rng.standard_normal(len(drive.t)), "right": drive.rate})
    with pytest.raises(InputError, match=r"does not show|do not match"):
        compare_filters(Recording(recording.nodes, wheels=foreign), "left", "gz", reference="wheels")
    columns = {**recording.nodes["left"].columns, "gz": np.full(len(drive.t), np.nan)}
    with pytest.raises(InputError, match="has no gz; use --channel with gx, gy"):
        compare_filters(Recording({"left": Table(columns)}), "left", "gz")


def test_a_reference_that_turns_differently_is_named():
    drive, recording = recorded(duration=60.0)
    turning = 1.0 + 0.2 * np.sin(0.4 * drive.t)  # another wheel, in curves
    other = Table({"t": drive.t, "left": RADIUS * drive.rate * turning, "right": drive.rate})
    result = compare_filters(Recording(recording.nodes, wheels=other), "left", "gz", reference="wheels")
    assert any("wheels.left turns differently" in note for note in result.notes)


def test_the_right_reference_is_not_doubted(drive_and_result):
    assert not any("turns differently" in note for note in drive_and_result[1].notes)
