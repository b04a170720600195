"""The cause of a reset from the registers of the processor (data sheets of RP2040 and RP2350)."""

from types import SimpleNamespace

import pytest
import reset_cause

from hubowire.messages import ResetCause

PWRON, HARD, WDT = 1, 2, 3
RP2040 = {"reason": 0x40058008, "chip_reset": 0x40064008}
RP2350 = {"reason": 0x400D8008, "chip_reset": 0x4010002C}
# CHIP_RESET. RP2040: HAD_POR 8, HAD_RUN 16; RP2350: HAD_POR 16, HAD_BOR 17, HAD_RUN_LOW 18.


def reported_cause(monkeypatch, name, cause, **registers):
    """Return the cause reported by the firmware for a cause of the port and register values (default 0)."""
    addresses = RP2350 if "RP2350" in name else RP2040
    mem32 = {address: registers.get(key, 0) for key, address in addresses.items()}
    causes = SimpleNamespace(PWRON_RESET=PWRON, WDT_RESET=WDT, reset_cause=lambda: cause, mem32=mem32)
    if "RP2" not in name:
        causes.HARD_RESET = HARD
    monkeypatch.setattr(reset_cause, "machine", causes)
    return ResetCause(reset_cause.reset_cause(name))


@pytest.mark.parametrize(
    ("name", "chip_reset", "cause"),
    [
        ("Raspberry Pi Pico with RP2040", 1 << 8, ResetCause.POWER_ON),
        ("Raspberry Pi Pico with RP2040", 1 << 16, ResetCause.HARD),
        ("Raspberry Pi Pico with RP2040", 1 << 17, ResetCause.POWER_ON),
        ("Raspberry Pi Pico 2 with RP2350", 1 << 16, ResetCause.POWER_ON),
        ("Raspberry Pi Pico 2 with RP2350", 1 << 17, ResetCause.BROWN_OUT),
        ("Raspberry Pi Pico 2 with RP2350", 1 << 18, ResetCause.HARD),
        ("Raspberry Pi Pico 2 with RP2350", 1 << 17 | 1 << 18, ResetCause.HARD),
    ],
)
def test_chip_reset_distinguishes_the_run_pin_from_power_on(monkeypatch, name, chip_reset, cause):
    assert reported_cause(monkeypatch, name, PWRON, chip_reset=chip_reset) == cause


@pytest.mark.parametrize("name", ["Pico with RP2040", "Pico 2 with RP2350"])
def test_a_forced_watchdog_reset_is_a_soft_reset(monkeypatch, name):
    """Bits of the register REASON: TIMER 0, FORCE 1."""
    assert reported_cause(monkeypatch, name, WDT, reason=1, chip_reset=1 << 16) == ResetCause.WATCHDOG
    assert reported_cause(monkeypatch, name, WDT, reason=2, chip_reset=1 << 16) == ResetCause.SOFT


@pytest.mark.parametrize(
    ("cause", "expected"),
    [
        (PWRON, ResetCause.POWER_ON),
        (HARD, ResetCause.SOFT),
        (WDT, ResetCause.WATCHDOG),
        (77, ResetCause.UNKNOWN),
    ],
)
def test_on_other_processors_the_cause_of_the_port_is_used(monkeypatch, cause, expected):
    assert reported_cause(monkeypatch, "Generic ESP32 module with ESP32", cause) == expected
