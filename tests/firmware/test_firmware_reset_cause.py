"""Why a processor started, from what its registers hold by the data sheets of RP2040 and RP2350."""

from types import SimpleNamespace

import pytest
import reset_cause

from hubowire.messages import ResetCause

PWRON, HARD, WDT = 1, 2, 3
RP2040 = {"reason": 0x40058008, "chip_reset": 0x40064008}
RP2350 = {"reason": 0x400D8008, "chip_reset": 0x4010002C}
# CHIP_RESET. RP2040: HAD_POR 8, HAD_RUN 16; RP2350: HAD_POR 16, HAD_BOR 17, HAD_RUN_LOW 18.


def reported_cause(monkeypatch, name, cause, **registers):
    """What the firmware says where the port says `cause`; registers that are not named hold nothing."""
    places = RP2350 if "RP2350" in name else RP2040
    mem32 = {address: registers.get(key, 0) for key, address in places.items()}
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
def test_chip_reset_tells_a_pulled_run_pin_from_power(monkeypatch, name, chip_reset, cause):
    assert reported_cause(monkeypatch, name, PWRON, chip_reset=chip_reset) == cause


@pytest.mark.parametrize("name", ["Pico with RP2040", "Pico 2 with RP2350"])
def test_a_watchdog_that_was_forced_is_a_reset_that_was_asked_for(monkeypatch, name):
    """REASON: TIMER 0, FORCE 1."""
    assert reported_cause(monkeypatch, name, WDT, reason=1, chip_reset=1 << 16) == ResetCause.WATCHDOG
    assert reported_cause(monkeypatch, name, WDT, reason=2, chip_reset=1 << 16) == ResetCause.SOFT


@pytest.mark.parametrize(
    ("cause", "meant"),
    [
        (PWRON, ResetCause.POWER_ON),
        (HARD, ResetCause.SOFT),
        (WDT, ResetCause.WATCHDOG),
        (77, ResetCause.UNKNOWN),
    ],
)
def test_of_another_processor_the_port_alone_tells(monkeypatch, cause, meant):
    assert reported_cause(monkeypatch, "Generic ESP32 module with ESP32", cause) == meant
