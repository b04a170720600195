"""Cause of the processor's reset, from the port and on an RP2 from registers that distinguish more.

The rp2 port reports only power-on and watchdog: `machine.reset` counts as a watchdog reset, the RUN pin as
power-on. The watchdog's REASON register separates a requested reset from an expired watchdog, CHIP_RESET a
pulled RUN pin from power-on. The esp32 port reports `machine.reset` as a hard reset and a brown-out, on an
ESP32 a pulled EN pin too, as power-on: `Parts` corrects that if the IMU has kept its settings.
"""

import machine
from micropython import const
from wire import (
    RESET_CAUSE_BROWN_OUT,
    RESET_CAUSE_HARD,
    RESET_CAUSE_POWER_ON,
    RESET_CAUSE_SOFT,
    RESET_CAUSE_UNKNOWN,
    RESET_CAUSE_WATCHDOG,
)

_FORCED = const(2)
# (part of the machine's name, address of REASON, address of CHIP_RESET, bits there: RUN pulled, brown-out)
_REGISTERS = (
    ("RP2040", 0x40058008, 0x40064008, 1 << 16, 0),
    ("RP2350", 0x400D8008, 0x4010002C, 1 << 18, 1 << 17),
)
# A port may lack some of these names.
_CAUSE_BY_PORT_NAME = (
    ("PWRON_RESET", RESET_CAUSE_POWER_ON),
    ("HARD_RESET", RESET_CAUSE_SOFT),
    ("WDT_RESET", RESET_CAUSE_WATCHDOG),
    ("SOFT_RESET", RESET_CAUSE_SOFT),
)


def reset_cause(name):
    """Return the ResetCause of this start. name: `sys.implementation._machine`."""
    cause = machine.reset_cause()
    for processor, reason, chip_reset, run, brown_out in _REGISTERS:
        if processor in name:
            if cause == machine.WDT_RESET:
                forced = machine.mem32[reason] & _FORCED
                return RESET_CAUSE_SOFT if forced else RESET_CAUSE_WATCHDOG
            bits = machine.mem32[chip_reset]
            if bits & run:
                return RESET_CAUSE_HARD
            return RESET_CAUSE_BROWN_OUT if bits & brown_out else RESET_CAUSE_POWER_ON
    for port_name, code in _CAUSE_BY_PORT_NAME:
        if cause == getattr(machine, port_name, None):
            return code
    return RESET_CAUSE_UNKNOWN
