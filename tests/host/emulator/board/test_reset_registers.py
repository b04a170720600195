"""Reset cause of an emulated board: code of the port and registers of the processor."""

import pytest

from hubodo.emulator.board.models import MODELS, ModelName
from hubodo.emulator.board.reset_registers import ResetCause, ResetRegisters


def _after(model: ModelName, *causes: ResetCause) -> dict[str, object]:
    registers = ResetRegisters(MODELS[model])
    for cause in causes:
        registers.reset(cause)
    return registers.as_config()


@pytest.mark.parametrize("model", MODELS)
def test_a_board_starts_by_power_on(model: ModelName) -> None:
    assert _after(model)["reset_cause"] == 1


@pytest.mark.parametrize(
    ("model", "cause", "code"),
    [
        # machine.PWRON_RESET = 1, HARD_RESET = 2, WDT_RESET = 3: the rp2 port resets by its watchdog.
        ("pico", "machine.reset", 3),
        ("pico", "reset pin", 1),
        ("pico_2_w", "watchdog", 3),
        ("esp32", "machine.reset", 2),
        ("esp32", "watchdog", 3),
        ("esp32_c3", "reset pin", 1),
    ],
)
def test_the_code_of_a_cause_is_that_of_the_port(model: ModelName, cause: ResetCause, code: int) -> None:
    assert _after(model, cause)["reset_cause"] == code


def test_the_registers_of_an_rp2040_are_those_of_its_data_sheet() -> None:
    """WATCHDOG: REASON at 0x40058000 + 0x08, bit 0 timer, bit 1 forced.

    CHIP_RESET: 0x40064000 + 0x08, bit 8 power-on or brown-out, bit 16 RUN pin.
    """
    assert _after("pico", "reset pin")["registers"] == {"40058008": 0, "40064008": 1 << 16}
    assert _after("pico", "brown-out")["registers"] == {"40058008": 0, "40064008": 1 << 8}
    # A watchdog reset preserves the record of the previous chip-level reset.
    assert _after("pico", "reset pin", "watchdog")["registers"] == {"40058008": 1, "40064008": 1 << 16}
    assert _after("pico", "machine.reset")["registers"] == {"40058008": 2, "40064008": 1 << 8}


def test_an_rp2350_distinguishes_brown_out_from_power_on_and_an_esp32_has_no_such_registers() -> None:
    assert _after("pico_2")["registers"] == {"400d8008": 0, "4010002c": 1 << 16}
    assert _after("pico_2", "brown-out")["registers"] == {"400d8008": 0, "4010002c": 1 << 17}
    assert _after("esp32", "brown-out")["registers"] == {}
