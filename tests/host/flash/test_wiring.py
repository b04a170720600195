"""The check of a board's I2C wiring: from levels and answers to a verdict with a remedy."""

import ast

import pytest

from hubodo.flash.wiring import WiringState, check_wiring, describe_device, find_board_pins, measure_lines
from hubowire.messages import Board

PULLED_UP, LOW, FLOATING = (1, 1), (0, 0), (0, 1)
IMU = ((0x6B, 0x69),)


@pytest.mark.parametrize(
    ("sda", "scl", "devices", "swapped", "verdict", "observation"),
    [
        (PULLED_UP, PULLED_UP, IMU, (), "ok", "0x6B answers 0x69: LSM6DS33"),
        (LOW, LOW, (), (), "wrong", "both lines are held low: SDA (GPIO4) and SCL (GPIO5)"),
        (LOW, PULLED_UP, (), (), "wrong", "SDA (GPIO4) is held low"),
        (PULLED_UP, LOW, (), (), "wrong", "SCL (GPIO5) is held low"),
        (FLOATING, FLOATING, (), (), "wrong", "no pull-up on SDA (GPIO4) and SCL (GPIO5)"),
        (PULLED_UP, FLOATING, (), (), "wrong", "no pull-up on SCL (GPIO5)"),
        (LOW, FLOATING, (), (), "wrong", "SDA (GPIO4) is held low"),
        (PULLED_UP, PULLED_UP, (), IMU, "wrong", "SDA and SCL are exchanged: 0x6B"),
        (PULLED_UP, PULLED_UP, (), (), "wrong", "nothing answers"),
    ],
)
def test_each_state_of_the_lines_has_its_verdict_and_each_failure_a_remedy(
    sda: tuple[int, int],
    scl: tuple[int, int],
    devices: tuple[tuple[int, int], ...],
    swapped: tuple[tuple[int, int], ...],
    verdict: str,
    observation: str,
) -> None:
    result = check_wiring(WiringState(4, 5, sda, scl, devices, swapped))
    assert (result.check, result.verdict) == ("wiring", verdict)
    assert observation in result.observation
    assert bool(result.remedy) == (verdict == "wrong")


@pytest.mark.parametrize(
    ("address", "identity", "text"),
    [
        (0x6B, 0x69, "0x6B answers 0x69: LSM6DS33, LSM6DS3 or LSM6DS3H (same identity)"),
        (0x1E, 0x3D, "0x1E answers 0x3D: LIS3MDL"),
        (0x68, 0x68, "0x68 answers 0x68: MPU-6050"),
        # The value alone does not identify a chip: 0x68 is that of an MPU-6050 only in its own register.
        (0x6B, 0x68, "0x6B answers 0x68: an unknown chip"),
        (0x50, -1, "0x50: a chip without a known identity register"),
    ],
)
def test_a_device_is_named_by_its_register_and_value(address: int, identity: int, text: str) -> None:
    assert describe_device(address, identity) == text


def test_the_test_code_is_valid_and_its_last_line_is_the_state() -> None:
    """The output of a board may also contain what its program printed before."""
    programs: list[str] = []

    def run(code: str) -> str:
        programs.append(code)
        return "boot\n((0, 1), (1, 1), [(107, 105)], [])\n"

    assert measure_lines({"sda": 8, "scl": 9}, run) == WiringState(8, 9, (0, 1), (1, 1), ((107, 105),), ())
    (program,) = programs
    ast.parse(program)
    assert "a,b=8,9" in program


@pytest.mark.parametrize(
    ("machine", "board", "pins"),
    [
        ("Raspberry Pi Pico W with RP2040", Board.PICO_W, (4, 5)),
        ("Raspberry Pi Pico 2 with RP2350", Board.PICO_2, (4, 5)),
        ("Generic ESP32S3 module with ESP32S3", Board.ESP32_S3, (8, 9)),
        ("ESP32C3 module with ESP32C3", Board.ESP32_C3, (6, 7)),
        ("Generic ESP32 module with ESP32", Board.ESP32, (21, 22)),
    ],
)
def test_pins_are_those_of_the_firmware_and_a_setting_replaces_its_own(
    machine: str, board: Board, pins: tuple[int, int]
) -> None:
    """Names as MicroPython reports them; pins as in the wiring table of firmware/README.md."""
    detected, numbers = find_board_pins(machine, {})
    assert (detected, numbers["sda"], numbers["scl"]) == (board, *pins)
    _, changed = find_board_pins(machine, {"pins": {"sda": 16}})
    assert changed == {**numbers, "sda": 16}
