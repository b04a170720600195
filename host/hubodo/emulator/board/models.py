"""Board models: names and pins, as MicroPython reports them.

From ports/rp2 and ports/esp32 of MicroPython (board names, arguments that constructors refuse) and the pin
tables of the RP2040, ESP32, ESP32-S3 and ESP32-C3; wired as in the table of firmware/README.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ModelName = Literal["pico", "pico_w", "pico_2", "pico_2_w", "esp32", "esp32_s3", "esp32_c3"]

_RP2_ADC = (26, 27, 28, 29)
VSYS_PIN, RADIO_SELECT_PIN = 29, 25
"""Pins of boards with `shares_radio_pin`: VSYS / 3 is at the first while the second is high."""


@dataclass(frozen=True)
class BoardModel:
    """A board model.

    Attributes
    ----------
    machine : sys.implementation._machine.
    platform : port of MicroPython.
    sda, scl : pins of the sensor board.
    pins : GPIO numbers that exist.
    adc : pins with an ADC.
    battery_pin, divider_ratio : pin of the battery voltage, and ratio of its divider.
    i2c, uart : number of units.
    shares_radio_pin : True if the battery pin is shared with the radio.
    """

    machine: str
    platform: Literal["rp2", "esp32"]
    sda: int
    scl: int
    pins: tuple[int, ...]
    adc: tuple[int, ...]
    battery_pin: int
    divider_ratio: float
    i2c: int = 2
    uart: int = 2
    shares_radio_pin: bool = False

    def as_config(self) -> dict[str, object]:
        """Return the settings of the interpreter."""
        return {
            "machine": self.machine,
            "platform": self.platform,
            "pins": list(self.pins),
            "adc_pins": list(self.adc),
            "i2c_count": self.i2c,
            "uart_count": self.uart,
            "radio": self.shares_radio_pin,
        }


def _pico(text: str, *, radio: bool = False) -> BoardModel:
    """Return the model of a Pico."""
    return BoardModel(text, "rp2", 4, 5, tuple(range(30)), _RP2_ADC, VSYS_PIN, 3.0, shares_radio_pin=radio)


MODELS: dict[ModelName, BoardModel] = {
    "pico": _pico("Raspberry Pi Pico with RP2040"),
    "pico_w": _pico("Raspberry Pi Pico W with RP2040", radio=True),
    "pico_2": _pico("Raspberry Pi Pico 2 with RP2350"),
    "pico_2_w": _pico("Raspberry Pi Pico 2 W with RP2350", radio=True),
    "esp32": BoardModel(
        "Generic ESP32 module with ESP32",
        "esp32",
        21,
        22,
        (*range(20), 21, 22, 23, 25, 26, 27, *range(32, 40)),
        (32, 33, 34, 35, 36, 37, 38, 39),
        35,
        2.0,
        uart=3,
    ),
    "esp32_s3": BoardModel(
        "Generic ESP32S3 module with ESP32S3",
        "esp32",
        8,
        9,
        (*range(22), *range(26, 49)),
        tuple(range(1, 21)),
        1,
        2.0,
        uart=3,
    ),
    "esp32_c3": BoardModel(
        "ESP32C3 module with ESP32C3", "esp32", 6, 7, tuple(range(22)), (0, 1, 2, 3, 4), 0, 2.0, i2c=1
    ),
}
