"""Peripherals of the processor: I2C, SPI, pins and ADC."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable
from typing import Protocol

from hubodo.emulator.board.bus import I2cBus, Pins
from hubodo.emulator.board.hypercall import ENODEV, Deferred, Handler, Op, Reply
from hubodo.emulator.board.models import RADIO_SELECT_PIN, BoardModel
from hubodo.emulator.board.spi_sensor import SpiSensor
from hubodo.units import NS_PER_S

RP2_ADC_PIN, RP2_CORE_TEMP = 26, 4
FLOATING_PIN_V = 0.4
EDGE_STEP_NS = 1e6
"""A sleeping processor notices an edge within this time."""
WAKE_UP_NS = 1e6
"""Assumed time from the end of a sleep until the clocks run again."""
SPI_BYTE_NS = 1000.0
"""Duration of a byte at 8 MHz, ns."""
_CORE_V = 0.706 - 0.001721 * (25.0 - 27.0)
# The chip select of the radio also switches the divider: 608 counts in MicroPython's issue 10406.
_DIVIDER_OFF_V = 0.0306


class RadioPins(Protocol):
    """Radio on SPI and pins, ESP-NOW and Bluetooth; `t` in ns."""

    def set_pin(self, t: float, number: int, level: int) -> None: ...

    def transfer(self, t: float, data: bytes) -> bytes: ...

    def call_espnow(self, t: float, request: bytes) -> tuple[int, bytes]: ...

    def call_bluetooth(self, t: float, request: bytes) -> tuple[int, bytes]: ...

    def reset(self) -> None: ...


class Peripherals:
    """Peripherals of one board.

    battery_mv: returns the supply voltage. radio_on: returns True while the radio uses the pins of the
    battery divider. now: returns the time, ns.
    """

    def __init__(
        self,
        model: BoardModel,
        bus: I2cBus,
        battery_mv: Callable[[], float],
        radio_on: Callable[[], bool],
        radio: RadioPins | None = None,
        *,
        spi_sensor: SpiSensor | None = None,
        now: Callable[[], float] = lambda: 0.0,
        counts: Counter[str] | None = None,
    ) -> None:
        self._radio, self._spi_sensor = radio, spi_sensor
        self._now, self.counts = now, Counter() if counts is None else counts
        self._model, self._bus, self._battery_mv, self._radio_on = model, bus, battery_mv, radio_on
        self.pins = Pins(bus)

    def reset(self) -> None:
        """Reset the pins, as at a restart of the processor."""
        self.pins = Pins(self._bus)
        if self._radio is not None:
            self._radio.reset()

    def handlers(self) -> dict[int, Handler]:
        """Return the handlers of the calls served here."""
        return {
            Op.I2C_INIT: self._i2c_init,
            Op.I2C_READ_MEM: self._i2c_read,
            Op.I2C_WRITE_MEM: self._i2c_write,
            Op.I2C_READ: self._i2c_read,
            Op.I2C_WRITE: self._i2c_write,
            Op.I2C_SCAN: self._i2c_scan,
            Op.I2C_START: self._i2c_start,
            Op.I2C_PUT: self._i2c_put,
            Op.I2C_TAKE: self._i2c_take,
            Op.PIN_INIT: self._pin_init,
            Op.PIN_SET: self._pin_set,
            Op.PIN_GET: self._pin_get,
            Op.ADC_READ: self._adc_read,
            Op.SPI: self._spi_transfer,
            Op.ESPNOW: self._espnow,
            Op.BLE: self._bluetooth,
            Op.LIGHT_SLEEP: self._light_sleep,
        }

    def _i2c_init(self, argument: int, payload: bytes, t: float) -> Reply:
        frequency, scl, sda = struct.unpack("<Ibb", payload)
        self._bus.initialise(frequency, scl, sda)
        return Reply(t)

    def _i2c_read(self, argument: int, payload: bytes, t: float) -> Reply:
        address, size, register, n = struct.unpack("<BBHH", payload)
        status, data, end = self._bus.read_mem(t * 1e-9, address, register.to_bytes(size, "big"), n)
        return Reply(end * NS_PER_S, status, data)

    def _i2c_write(self, argument: int, payload: bytes, t: float) -> Reply:
        address, size, register = struct.unpack_from("<BBH", payload)
        status, end = self._bus.write(t * 1e-9, address, register.to_bytes(size, "big") + payload[4:])
        return Reply(end * NS_PER_S, status)

    def _i2c_scan(self, argument: int, payload: bytes, t: float) -> Reply:
        addresses, end = self._bus.scan(t * 1e-9)
        return Reply(end * NS_PER_S, len(addresses), addresses)

    def _i2c_start(self, argument: int, payload: bytes, t: float) -> Reply:
        return Reply(t, self._bus.start(t * 1e-9, payload[0], payload[2:]))

    def _i2c_put(self, argument: int, payload: bytes, t: float) -> Reply:
        self._bus.write_bytes(t * 1e-9, payload)
        return Reply(t)

    def _i2c_take(self, argument: int, payload: bytes, t: float) -> Reply:
        return Reply(t, self._bus.read_byte(t * 1e-9))

    def _pin_init(self, argument: int, payload: bytes, t: float) -> Reply:
        mode, pull = struct.unpack("<bb", payload)
        self.pins.initialise(t * 1e-9, argument, mode, pull)
        return Reply(t)

    def _pin_set(self, argument: int, payload: bytes, t: float) -> Reply:
        self.pins.set_level(t * 1e-9, argument, payload[0])
        if self._spi_sensor is not None and argument == self._spi_sensor.select_pin:
            self._spi_sensor.select(t * 1e-9, payload[0])
        if self._radio is not None:
            self._radio.set_pin(t, argument, payload[0])
        return Reply(t)

    def _spi_transfer(self, argument: int, payload: bytes, t: float) -> Reply:
        if self._spi_sensor is not None and self._spi_sensor.is_selected:
            received = self._spi_sensor.transfer(t * 1e-9, payload)
        else:
            received = bytes(len(payload)) if self._radio is None else self._radio.transfer(t, payload)
        return Reply(t + len(payload) * SPI_BYTE_NS, len(received), received)

    def _espnow(self, argument: int, payload: bytes, t: float) -> Reply:
        status, answer = (0, b"") if self._radio is None else self._radio.call_espnow(t, payload)
        return Reply(t, status, answer)

    def _bluetooth(self, argument: int, payload: bytes, t: float) -> Reply:
        status, answer = (-ENODEV, b"") if self._radio is None else self._radio.call_bluetooth(t, payload)
        return Reply(t, status, answer)

    def _pin_get(self, argument: int, payload: bytes, t: float) -> Reply:
        return Reply(t, self.pins.get_level(t * 1e-9, argument))

    def _light_sleep(self, argument: int, payload: bytes, t: float) -> Deferred:
        """Sleep until a rising edge of the pin, or for the time in the payload."""
        end = t + struct.unpack("<I", payload)[0] * 1e6
        pin, checked = argument - 1, t
        level = self.pins.get_level(t * 1e-9, pin) if argument else 0

        def poll_reply(late: bool) -> Reply | None:
            nonlocal checked, level
            now = min(self._now(), end)
            while argument and checked < now:
                checked = min(checked + EDGE_STEP_NS, now)
                before, level = level, self.pins.get_level(checked * 1e-9, pin)
                if level > before:
                    self.counts["woken_by_pin"] += 1
                    return Reply(checked + WAKE_UP_NS, 1)
            return Reply(end + WAKE_UP_NS) if late else None

        self.counts["light_sleeps"] += 1
        return Deferred(end - t, poll_reply)

    def _adc_read(self, argument: int, payload: bytes, t: float) -> Reply:
        counts = max(0, min(65535, round(self._volts(argument) / 3.3 * 65535)))
        return Reply(t, payload=struct.pack("<H", counts))

    def _volts(self, channel: int) -> float:
        """Return the voltage at an ADC channel.

        On rp2, channels 0 to 3 are the ADC pins and channel 4 is the core temperature.
        """
        model = self._model
        rp2 = model.platform == "rp2"
        if rp2 and channel == RP2_CORE_TEMP:
            return _CORE_V
        pin = channel + RP2_ADC_PIN if rp2 and channel < RP2_CORE_TEMP else channel
        if pin != model.battery_pin:
            return FLOATING_PIN_V
        if model.shares_radio_pin and (self._radio_on() or not self.pins.drives_high(RADIO_SELECT_PIN)):
            return _DIVIDER_OFF_V
        return self._battery_mv() / 1000 / model.divider_ratio
