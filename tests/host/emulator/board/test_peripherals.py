"""Peripherals of an emulated board: ADC with battery divider, I2C, SPI and pins."""

import struct

import pytest

from hubodo.emulator.board.bus import I2cBus
from hubodo.emulator.board.hypercall import EIO, Op
from hubodo.emulator.board.models import MODELS, ModelName
from hubodo.emulator.board.peripherals import Peripherals

RADIO_SELECT, OUTPUT = 25, 1


class Radio:
    """A radio that returns each byte plus one and records its pins."""

    def __init__(self) -> None:
        self.pins: list[tuple[int, int]] = []

    def set_pin(self, t: float, number: int, level: int) -> None:
        self.pins.append((number, level))

    def transfer(self, t: float, data: bytes) -> bytes:
        return bytes((byte + 1) & 0xFF for byte in data)

    def call_espnow(self, t: float, request: bytes) -> tuple[int, bytes]:
        return 7, request[::-1]

    def reset(self) -> None:
        self.pins.clear()


def _board(model: ModelName, *, radio_on: bool = False, radio: Radio | None = None) -> Peripherals:
    return Peripherals(MODELS[model], I2cBus(()), lambda: 3700.0, lambda: radio_on, radio)


def _volts(board: Peripherals, channel: int) -> float:
    reply = board.handlers()[Op.ADC_READ](channel, b"", 0.0)
    return float(struct.unpack("<H", reply.payload)[0]) / 65535 * 3.3


@pytest.mark.parametrize(
    ("model", "channel", "ratio"), [("pico", 3, 3.0), ("esp32", 35, 2.0), ("esp32_s3", 1, 2.0)]
)
def test_the_adc_reads_the_battery_behind_the_divider_of_the_board(
    model: ModelName, channel: int, ratio: float
) -> None:
    """Channel 3 of an RP2 is GPIO29; an ESP32 names pins."""
    step = 3.3 / 65535
    assert _volts(_board(model), channel) == pytest.approx(3.7 / ratio, abs=step)
    # Another pin floats.
    assert _volts(_board(model), channel - 1) == pytest.approx(0.4, abs=step)


def test_the_core_temperature_of_a_pico_reads_25_degrees() -> None:
    """T = 27 - (V - 0.706) / 0.001721, section 4.9.5 of the RP2040's data sheet."""
    volts = _volts(_board("pico"), 4)
    assert 27.0 - (volts - 0.706) / 0.001721 == pytest.approx(25.0, abs=0.05)


def test_a_pico_w_reads_its_battery_only_while_the_radio_is_off_and_deselected() -> None:
    board = _board("pico_w")
    off = _volts(board, 3)
    assert off < 0.05
    handlers = board.handlers()
    handlers[Op.PIN_INIT](RADIO_SELECT, struct.pack("<bb", OUTPUT, 0), 0.0)
    handlers[Op.PIN_SET](RADIO_SELECT, b"\1", 0.0)
    assert _volts(board, 3) == pytest.approx(3.7 / 3.0, abs=1e-4)
    board.reset()
    assert _volts(board, 3) == off
    board = _board("pico_w", radio_on=True)
    board.handlers()[Op.PIN_INIT](RADIO_SELECT, struct.pack("<bb", OUTPUT, 0), 0.0)
    board.handlers()[Op.PIN_SET](RADIO_SELECT, b"\1", 0.0)
    assert _volts(board, 3) == off


def test_an_address_without_a_chip_is_not_acknowledged_and_the_scan_is_empty() -> None:
    handlers = _board("pico").handlers()
    read = handlers[Op.I2C_READ_MEM](0, struct.pack("<BBHH", 0x6B, 1, 0x0F, 1), 5_000.0)
    assert (read.status, read.payload) == (-EIO, b"")
    # Start, address and acknowledgement take ten bits of 2.5 us.
    assert 5_000.0 + 20_000.0 < read.t < 5_000.0 + 60_000.0
    scan = handlers[Op.I2C_SCAN](0, b"", 0.0)
    assert (scan.status, scan.payload) == (0, b"")


def test_spi_takes_a_microsecond_per_byte_and_reads_zeros_without_a_radio() -> None:
    reply = _board("pico").handlers()[Op.SPI](0, b"\x07\xff", 100.0)
    assert (reply.status, reply.payload, reply.t) == (2, b"\0\0", 100.0 + 2_000.0)


def test_the_radio_gets_spi_pins_and_espnow_and_is_reset_with_the_processor() -> None:
    radio = Radio()
    board = _board("pico", radio=radio)
    handlers = board.handlers()
    assert handlers[Op.SPI](0, b"\x07\xff", 0.0).payload == b"\x08\x00"
    reply = handlers[Op.ESPNOW](0, b"abc", 0.0)
    assert (reply.status, reply.payload) == (7, b"cba")
    handlers[Op.PIN_INIT](17, struct.pack("<bb", OUTPUT, 0), 0.0)
    handlers[Op.PIN_SET](17, b"\0", 0.0)
    assert radio.pins == [(17, 0)]
    board.reset()
    assert radio.pins == []


def test_espnow_without_a_radio_is_no_error() -> None:
    reply = _board("esp32").handlers()[Op.ESPNOW](0, b"abc", 3.0)
    assert (reply.status, reply.payload, reply.t) == (0, b"", 3.0)
