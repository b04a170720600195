"""Battery life, calculated by hand."""

import power
import pytest


def test_a_cell_lasts_its_usable_energy_divided_by_the_power():
    """3 Ah at 3.6 V are 10.8 Wh, of which 90 % are used: 9.72 Wh, 97.2 h at 100 mW."""
    assert power.hours(3.0, 100.0) == pytest.approx(97.2)
    assert power.daily_mean(120.0, 24.0) == pytest.approx((2 * 120 + 22 * 24) / 24)


def test_a_load_behind_the_regulator_costs_more_and_time_awake_more_than_waiting():
    load = power.Load("a", 1.0, 3.3, "", supplied=True)
    assert power.milliwatts(load) == pytest.approx(3.3 / 0.85)
    assert power.node_milliwatts(0.0) == pytest.approx(105.0)
    assert power.node_milliwatts(0.5, load) == pytest.approx(0.5 * 130 + 0.5 * 105 + 3.3 / 0.85)


def test_a_parked_node_wakes_up_for_8_ms_in_4_s():
    expected = 0.002 * 130 + 0.998 * 0.99 * 5 + 0.55 * 3.3 / 0.85
    assert power.parked_milliwatts(power.PARKED_BOARDS[0]) == pytest.approx(expected)


def test_an_esp32_parks_for_two_months_and_a_pico_does_not():
    """60 days of 9.72 Wh are 6.75 mW. A C3 reads the detector ten times a second."""
    pico, s3, c3 = (power.hours(3.0, power.parked_milliwatts(board)) / 24 for board in power.PARKED_BOARDS)
    assert pico < 60 < min(s3, c3)
    awake = 0.002 + 0.02
    c3_milliwatts = awake * 25 * 3.8 + (1 - awake) * 0.18 * 3.8 + 0.55 * 3.6
    assert c3 == pytest.approx(9720 / c3_milliwatts / 24)


def test_each_current_has_a_source_and_both_tables_are_printed(capsys):
    loads = (
        power.AWAKE,
        power.WAITING,
        *(load for board in power.PARKED_BOARDS for load in (board.asleep, board.awake)),
        power.IMU_ASLEEP,
        *power.IMUS,
        power.MAGNETOMETER,
        power.RADIO,
    )
    assert all(load.source for load in loads)
    assert power.main(["--awake", "0.26"]) == 0
    text = capsys.readouterr().out
    assert "lightsleep" in text and "issue 8770" in text
    with pytest.raises(SystemExit):
        power.main(["--settings", "fast"])
