"""Nodes that are parked: asleep until motion; no sample is lost while falling asleep or waking up."""

import numpy as np
import pytest

from hubodo.emulator.board.settings import BoardSettings, SensorBoard
from hubowire import messages as m
from parking_runs import PARK_AFTER_S, WAKE_PINS, park
from repetitions import first_and_more
from virtual_runs import run


@pytest.mark.parametrize(
    ("model", "chip", "wired"),
    [
        ("esp32_s3", "lsm6dso", True),
        *first_and_more(("pico", "lsm6ds33", False), ("pico", "lsm6dso", True), ("pico", "lsm6dsv", True)),
    ],
)
def test_a_parked_node_sleeps_and_loses_no_sample_from_before_its_wake_up(model, chip, wired):
    result = park(2, model=model, chip=chip, wired=wired)
    assert result.falls_asleep >= 2 and result.lost == 0
    # Time to notice: an edge at once, the register every 0.1 s; then a sample at 26 Hz, and the FIFO.
    assert np.all(result.delays < (0.15 if wired else 0.25))
    # The newest sample is polled every 0.1 ms and more; the period comes from the full rate.
    assert np.abs(result.stamp_errors).max() < 1000
    assert result.light_sleeps > (3 if wired else 50)
    assert result.decoder.counts.samples_lost == result.decoder.counts.gaps == 0
    assert np.all(np.diff(result.device_s) > 0)
    assert {health.faults for health in result.healths} == {0, m.Fault.ASLEEP}
    asleep = np.diff([h.t_us for h in result.healths if h.faults & m.Fault.ASLEEP]) / 1e6
    assert len(asleep) > 1 and np.all(asleep[asleep < 5.0] > 3.9), "it reports every four seconds"
    assert {hello.accel_range_g for hello in result.hellos if hello.rate_mhz} == {2, 16}


@pytest.mark.parametrize("chip", ["icm42688"])
def test_a_node_whose_chip_detects_no_motion_does_not_sleep(chip):
    sent, _, stats = run(
        PARK_AFTER_S + 2.0,
        config={"link": "uart", "park_after_s": PARK_AFTER_S},
        board=BoardSettings(uart_link=0),
        sensors=SensorBoard(chip),
    )
    assert "light_sleeps" not in stats["counts"] and sent


@pytest.mark.parametrize(("model", "pin"), first_and_more(("esp32_c3", 0), ("esp32", 5)))
def test_an_esp32_without_a_pin_that_wakes_it_reads_the_detector(model, pin, monkeypatch):
    """A C3 has no such pin at all, an ESP32 only those of its RTC."""
    monkeypatch.setitem(WAKE_PINS, model, pin)
    result = park(1, model=model)
    assert result.falls_asleep >= 1 and result.lost == 0
    assert result.light_sleeps > 25
