"""Boards, recognised by the name that MicroPython reports, and their pins."""

from wire import (
    BOARD_ESP32,
    BOARD_ESP32_C3,
    BOARD_ESP32_S3,
    BOARD_OTHER,
    BOARD_PICO,
    BOARD_PICO_2,
    BOARD_PICO_2_W,
    BOARD_PICO_W,
    BOARD_RP2,
)

# battery: ADC pin, or -1; battery_factor: supply over ADC voltage; battery_enable: driven high to measure.
# /config.json may add "wake", the pin wired to INT1 of the IMU, and "imu_csn", its chip select on SPI.
_PICO_PINS = {
    "i2c": 0,
    "sda": 4,
    "scl": 5,
    "uart": 0,
    "tx": 0,
    "rx": 1,
    "battery": 29,
    "battery_factor": 3,
    "battery_enable": -1,
    "spi": 0,
    "sck": 18,
    "mosi": 19,
    "miso": 16,
    "csn": 17,
    "ce": 20,
}
# GPIO25 is the radio's chip select, GPIO29 its clock: VSYS / 3 is on it only while the radio is not selected.
_PICO_W_PINS = dict(_PICO_PINS, battery_enable=25)
_RP2_PINS = dict(_PICO_PINS, battery=-1)
# These boards have no voltage divider: /config.json names the pin of the battery.
_ESP32_PINS = dict(_PICO_PINS, sda=21, scl=22, uart=2, tx=17, rx=16, battery=-1, battery_factor=2)
_ESP32_PINS.update(spi=1, sck=14, mosi=13, miso=27, csn=26, ce=25)
# GPIO22 to 25 do not exist; 26 to 37 belong to flash and PSRAM, 19 and 20 to USB.
_ESP32_S3_PINS = dict(
    _ESP32_PINS, sda=8, scl=9, uart=1, tx=17, rx=18, sck=12, mosi=11, miso=13, csn=10, ce=14
)
# GPIO22 and up do not exist; 11 to 17 belong to flash, 18 and 19 to USB, 20 and 21 to the console.
_ESP32_C3_PINS = dict(_ESP32_PINS, sda=6, scl=7, uart=1, tx=4, rx=5, sck=2, mosi=3, miso=10, csn=1, ce=0)

# (end of the machine name, Board, pins): the first that matches.
_PINS_OF_MACHINE = (
    ("Raspberry Pi Pico W with RP2040", BOARD_PICO_W, _PICO_W_PINS),
    ("Raspberry Pi Pico 2 W with RP2350", BOARD_PICO_2_W, _PICO_W_PINS),
    ("Raspberry Pi Pico with RP2040", BOARD_PICO, _PICO_PINS),
    ("Raspberry Pi Pico 2 with RP2350", BOARD_PICO_2, _PICO_PINS),
    (" with RP2040", BOARD_RP2, _RP2_PINS),
    (" with RP2350", BOARD_RP2, _RP2_PINS),
    (" with ESP32", BOARD_ESP32, _ESP32_PINS),
    (" with ESP32S3", BOARD_ESP32_S3, _ESP32_S3_PINS),
    (" with ESP32C3", BOARD_ESP32_C3, _ESP32_C3_PINS),
)

WITH_RADIO = (BOARD_PICO_W, BOARD_PICO_2_W)
"""Boards whose radio shares a pin with the battery measurement."""


def board_of(machine):
    """Return (Board, pins) for the text of `sys.implementation._machine`."""
    # "ESP32-S3" in some versions; "RP2350-RISCV" when the RISC-V cores run.
    text = machine.replace("-RISCV", "").replace("-", "")
    for ending, kind, pins in _PINS_OF_MACHINE:
        if text.endswith(ending):
            return kind, dict(pins)
    return BOARD_OTHER, dict(_RP2_PINS)
