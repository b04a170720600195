"""A gyro axis on a rate table: figures against the errors simulated, by the verb and by the parts."""

import json
from dataclasses import replace

import numpy as np
import pytest

from generators.odd_records import missing_codes
from generators.rate_table import Axis, slip, turn_table
from hubodo.calibration.file import read_calibration
from hubodo.cli import main
from hubodo.errors import CalibrationError, InputError
from hubodo.log.rate_file import read_rate_file
from hubodo.sensors.rate_table.calibrate import RateOptions, calibrate_rate

AXIS = Axis(bias=0.01, scale=0.004, asymmetry=2e-3, cubic=1.6e-4, hysteresis=2e-3)
FULL_SCALE = np.radians(200)


def calibrate(axis, seed=1, by_list=False, **options):
    t, gyro, table = turn_table(np.random.default_rng(seed), axis, seconds=8.0, rounds=2)
    given = {"rates": table[:, 1]} if by_list else {"table": (table[:, 0], table[:, 1])}
    return calibrate_rate(t, gyro, "imu", "z", RateOptions(**given, **options))


def write_files(folder, axis=AXIS):
    t, gyro, table = turn_table(np.random.default_rng(2), axis, seconds=8.0, rounds=1)
    table[:, 1] = np.degrees(table[:, 1])
    np.savetxt(folder / "imu.csv", np.c_[t, gyro], delimiter=",", header="t,gz (rad/s)", comments="")
    np.savetxt(folder / "rates.csv", table, delimiter=",", header="t,rate_deg_s", comments="")
    return table


def run(folder, *options):
    log, out = str(folder / "imu.csv"), str(folder / "c.toml")
    return main(["calibrate", "rate", log, "--node", "imu", "-o", out, *options])


@pytest.mark.parametrize("by_list", [False, True])
def test_scale_asymmetry_nonlinearity_and_hysteresis_are_those_simulated(by_list):
    result = calibrate(AXIS, by_list=by_list)
    fit, true = result.fit, AXIS.static(result.fit.rates)
    slope, offset = np.polyfit(fit.rates, true, 1)
    pairs = [
        (fit.scale_error, slope - 1),
        (fit.asymmetry, AXIS.asymmetry / (1 + AXIS.scale)),
        (fit.hysteresis, AXIS.hysteresis),
        (fit.bias, AXIS.bias + offset),
    ]
    for quantity, truth in pairs:
        assert abs(quantity.value - truth) < 4 * quantity.sigma
        assert quantity.sigma < 0.2 * abs(truth)
    assert np.all(np.abs(fit.deviation - (true - slope * fit.rates - offset)) < 4 * fit.deviation_sigma)
    assert result.is_nonlinear and len(result.plateaus.rate) == 33


def test_a_linear_gyro_without_hysteresis_has_a_bound_instead_of_a_nonlinearity():
    result = calibrate(Axis(bias=0.01, scale=0.004))
    assert not result.is_nonlinear
    assert abs(result.fit.hysteresis.value) < 4 * result.fit.hysteresis.sigma
    bound = result.as_json()["nonlinearity"]["upper_bound"]
    assert abs(result.fit.nonlinearity.value) / FULL_SCALE < bound < 1e-4


def test_a_walking_bias_widens_the_sigma_of_the_scale():
    calm, walking = (calibrate(Axis(walk=walk)).fit.scale_error for walk in (0.0, 3e-4))
    assert walking.sigma > 10 * calm.sigma
    assert abs(walking.value) < 4 * walking.sigma


def test_a_disturbed_plateau_is_named_and_left_out():
    t, gyro, table = turn_table(np.random.default_rng(3), AXIS, seconds=8.0)
    kicked = (t > table[5, 0] + 3) & (t < table[5, 0] + 3.4)
    gyro[kicked] += 0.3
    result = calibrate_rate(t, gyro, "imu", "z", RateOptions(table=(table[:, 0], table[:, 1])))
    assert len(result.plateaus.rate) == 32
    assert result.notes[0].startswith("plateau of 150 deg/s") and "disturbed" in result.notes[0]


def turn(seed, count=0, codes=False):
    """Calibrate a linear gyro with this number of slipped plateaus, or with uneven codes."""
    rng = np.random.default_rng(seed)
    t, gyro, table = turn_table(rng, Axis(scale=0.004), seconds=8.0)
    gyro = slip(rng, t, gyro, table, count)
    if codes:
        gyro = missing_codes(t, gyro[:, None], None, rng, 0.0)[1][:, 0]
    return calibrate_rate(t, gyro, "imu", "z", RateOptions(table=(table[:, 0], table[:, 1])))


def test_a_slipping_table_is_named_or_refused():
    result = turn(1, count=1)
    assert "from the others of this rate, as if the table had slipped" in result.notes[0]
    assert len(result.plateaus.rate) == 32
    assert abs(result.fit.scale_error.value - 0.004) < 4 * result.fit.scale_error.sigma < 4e-5
    with pytest.raises(CalibrationError, match=r"times their noise, .* the table slips"):
        turn(1, count=10)


def test_uneven_codes_are_part_of_the_sigma_of_each_rate():
    even, uneven = turn(2), turn(2, codes=True)
    assert "the codes of the gyro's converter are uneven by" in uneven.notes[0]
    assert uneven.fit.scale_error.sigma > 2 * even.fit.scale_error.sigma
    assert abs(uneven.fit.scale_error.value - 0.004) < 4 * uneven.fit.scale_error.sigma


def test_the_verb_adds_bias_and_scale_to_the_other_axes_of_the_file(tmp_path, capsys):
    write_files(tmp_path)
    (tmp_path / "c.toml").write_text(
        "[nodes.imu.effects.gyro_scale_factor]\nx = { value = 0.5, sigma = 0.1 }\n"
    )
    stated = ("--table", str(tmp_path / "rates.csv"), "--latitude-deg", "50", "--full-scale-deg-s", "250")
    assert run(tmp_path, *stated, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["full_scale"] == pytest.approx(np.radians(250))
    scale = read_calibration(tmp_path / "c.toml").nodes["imu"].effects["gyro_scale_factor"].parameters
    assert scale["x"].value == 0.5
    assert scale["z"].value == result["scale_error"]["value"]
    assert run(tmp_path, *stated) == 0
    shown = capsys.readouterr().out
    assert "asymmetry" in shown and "ppm of full scale" in shown


@pytest.mark.parametrize(
    "options, words",
    [
        ((), "--table"),
        (("--rates-deg-s=0,50,100",), "17 steady segments"),
        (("--rates-deg-s=0,x",), "--rates-deg-s"),
        (("--rates-deg-s=" + ",".join(["1"] * 17),), "in both directions"),
        (("--axis", "x", "--table", "{}/rates.csv"), "gx"),
        (("--settle", "4.1", "--table", "{}/rates.csv"), "--settle"),
        (("--table", "{}/reversed.csv"), "other way"),
        (("--table", "{}/no_unit.csv"), "name it rate_deg_s"),
        (("--table", "{}/imu.csv"), "columns t and rate"),
    ],
)
def test_what_is_missing_or_contradictory_is_named(tmp_path, capsys, options, words):
    table = write_files(tmp_path)
    np.savetxt(
        tmp_path / "reversed.csv", table * [1, -1], delimiter=",", header="t,rate (deg/s)", comments=""
    )
    np.savetxt(tmp_path / "no_unit.csv", table, delimiter=",", header="t,rate", comments="")
    assert run(tmp_path, *(text.format(tmp_path) for text in options)) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("shift", [1.5, -2.0, 4.0])
def test_a_table_with_another_clock_is_refused(shift):
    t, gyro, table = turn_table(np.random.default_rng(5), AXIS, seconds=8.0)
    with pytest.raises(InputError, match="clocks of table and log differ"):
        calibrate_rate(t, gyro, "imu", "z", RateOptions(table=(table[:, 0] + shift, table[:, 1])))


def test_a_table_without_both_directions_or_asymmetry_is_refused_or_says_so():
    t, gyro, table = turn_table(np.random.default_rng(4), AXIS, steps_deg_s=(0, 50, 100, 150, 0), rounds=1)
    with pytest.raises(CalibrationError, match="both directions"):
        calibrate_rate(t, gyro, "imu", "z", RateOptions(table=(table[:, 0], table[:, 1])))
    with pytest.raises(InputError, match="not numbers"):
        calibrate_rate(t, np.append(gyro[1:], np.nan), "imu", "z", RateOptions(rates=(0.0,)))


def test_times_and_rates_in_other_units_are_those_of_the_heading(tmp_path):
    (tmp_path / "a.csv").write_text("t_ms,rate (rad/s)\n0,1\n2000,2\n")
    t, rate = read_rate_file(tmp_path / "a.csv")
    assert list(t) == [0.0, 2.0] and list(rate) == [1.0, 2.0]
    (tmp_path / "a.csv").write_text("t,rate (g)\n0,1\n2,2\n")
    with pytest.raises(InputError, match="no rate"):
        read_rate_file(tmp_path / "a.csv")


def test_the_noise_of_many_repeated_rates_is_neither_hysteresis_nor_drift():
    fits = [calibrate(replace(AXIS, hysteresis=0.0), seed=seed).fit for seed in range(4)]
    pulls = [it.hysteresis.value / it.hysteresis.sigma for it in fits] + [
        it.drift.value / it.drift.sigma for it in fits
    ]
    assert np.abs(pulls).max() < 4.0 and np.abs(pulls).max() > 0.1
