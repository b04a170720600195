"""The emulated I2C bus and its pins: bit timing, missing acknowledgements, a slave that holds SDA low."""

from __future__ import annotations

import pytest

from hubodo.emulator.board.bus import I2cBus, Pins
from hubodo.emulator.chips.faults import BusNack, StuckBus
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.lsm6ds33 import Lsm6ds33
from hubodo.emulator.motion import StillMotion


def bus(*faults: object) -> I2cBus:
    return I2cBus([Lsm6ds33(StillMotion(), Specimen(faults=faults))], faults)  # type: ignore[arg-type]


def test_reading_twelve_bytes_takes_the_time_of_their_bits_at_400_khz() -> None:
    status, data, end = bus().read_mem(1.0, 0x6B, b"\x22", 12)
    bits = 1 + 9 + 9 + 1 + 9 + 12 * 9 + 1
    assert status == len(data) == 12
    assert end - 1.0 == pytest.approx((bits + 1) / 400e3, abs=1.5 / 400e3)


def test_a_slower_bus_takes_longer() -> None:
    wires = bus()
    wires.initialise(100_000, -1, -1)
    assert wires.read_mem(1.0, 0x6B, b"\x22", 12)[2] - 1.0 == pytest.approx(139 / 100e3, rel=0.03)


def test_nobody_at_an_address_is_eio() -> None:
    assert bus().read_mem(1.0, 0x33, b"\x0f", 1)[0] == -5
    assert bus().write(1.0, 0x33, b"\x0f")[0] == -5


def test_a_refusing_chip_is_eio_for_so_many_times() -> None:
    wires = bus(BusNack(0.5, 2))
    assert [wires.read_mem(1.0, 0x6B, b"\x0f", 1)[0] for _ in range(3)] == [-5, -5, 1]


def test_scan_finds_the_chip() -> None:
    assert bus().scan(1.0)[0] == b"\x6b"


def test_a_stuck_slave_lets_go_after_nine_pulses_on_scl_and_not_before() -> None:
    wires = bus(StuckBus(2.0))
    pins = Pins(wires)
    assert wires.read_mem(1.9, 0x6B, b"\x0f", 1)[0] == 1
    status, _, end = wires.read_mem(2.1, 0x6B, b"\x0f", 1)
    assert status == -110 and end - 2.1 == pytest.approx(0.05)
    pins.initialise(3.0, 0, 0, 1)
    pins.initialise(3.0, 1, 2, -1)
    assert pins.get_level(3.0, 0) == 0
    for k in range(9):
        assert pins.get_level(3.0, 0) == 0, k
        pins.set_level(3.0, 1, 0)
        pins.set_level(3.0, 1, 1)
    assert pins.get_level(3.0, 0) == 1
    assert wires.read_mem(3.1, 0x6B, b"\x0f", 1)[0] == 1
