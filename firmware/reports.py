"""The periodic messages Hello, Filter and Health. Nothing here allocates."""

import struct
from time import ticks_us

from framing import PAYLOAD
from micropython import const
from wire import (
    FAULT_LOW_BATTERY,
    FILTER,
    FILTER_FORMAT,
    FILTER_SIZE,
    FINGERPRINT,
    HEALTH,
    HEALTH_FORMAT,
    HEALTH_SIZE,
    HELLO,
    HELLO_FORMAT,
    HELLO_ROW,
    HELLO_ROW_SIZE,
    HELLO_SIZE,
)

VERSION = (0, 1, 0)

_U16 = const(0xFFFF)
_UNKNOWN = const(255)
_EXTERNAL_MV = const(4300)
_HALF_MV = const(3840)


def hello(node):
    """Queue Hello."""
    parts, board = node.parts, node.board
    chip, mag = parts.chip, parts.mag
    raw = node.outbox.note()
    struct.pack_into(
        HELLO_FORMAT,
        raw,
        PAYLOAD,
        FINGERPRINT,
        VERSION[0],
        VERSION[1],
        VERSION[2],
        board.serial,
        board.boot_id,
        board.kind,
        board.reset_cause,
        chip.rate_mhz if chip else 0,
        chip.range_dps if chip else 0,
        chip.range_g if chip else 0,
        chip.gyro_lsb_ndps if chip else 0,
        chip.accel_lsb_ng if chip else 0,
        chip.temperature_lsb_udegc if chip else 0,
        chip.temperature_offset_udegc if chip else 0,
        mag.lsb_ft if mag else 0,
        parts.batch,
        node.settings["filter_kind"],
        node.sampler.clock.bound_us(),
        len(parts.chips),
    )
    at = PAYLOAD + HELLO_SIZE
    for address, who_am_i, part in parts.chips:
        struct.pack_into(HELLO_ROW, raw, at, address, who_am_i, part)
        at += HELLO_ROW_SIZE
    node.outbox.post(HELLO, at - PAYLOAD)


def filter_state(node):
    """Queue Filter."""
    f, init = node.estimator, node.init
    struct.pack_into(
        FILTER_FORMAT,
        node.outbox.note(),
        PAYLOAD,
        node.sampler.newest_us,
        init.state,
        f.saturations,
        init.samples,
        f.rate_q8(0),
        f.rate_q8(1),
        f.rate_q8(2),
        f.bias_q12(0),
        f.bias_q12(1),
        f.bias_q12(2),
        init.variance_q8[0],
        init.variance_q8[1],
        init.variance_q8[2],
        init.sigma_q12[0],
        init.sigma_q12[1],
        init.sigma_q12[2],
    )
    node.outbox.post(FILTER, FILTER_SIZE)


def _charge(mv):
    """Return the charge of a lithium cell under light load, %, within some 8 %; 255: unknown."""
    if not 0 < mv < _EXTERNAL_MV:
        return _UNKNOWN
    above = mv - _HALF_MV
    share = 50 + above * 50 // (360 if above > 0 else 240)
    return max(0, min(share, 100))


def health(node):
    """Queue Health; the maximum turn duration is reset."""
    parts, battery_mv = node.parts, node.board.battery_mv()
    if 0 < battery_mv < node.settings["low_battery_mv"]:
        parts.faults |= FAULT_LOW_BATTERY
    else:
        parts.faults &= ~FAULT_LOW_BATTERY
    struct.pack_into(
        HEALTH_FORMAT,
        node.outbox.note(),
        PAYLOAD,
        ticks_us(),
        battery_mv,
        parts.faults,
        min(parts.i2c_errors, _U16),
        min(parts.recoveries, _U16),
        min(node.sampler.overruns, _U16),
        min(node.sampler.missed, _U16),
        min(node.outbox.dropped, _U16),
        min(node.link.reader.damaged, _U16),
        node.outbox.high_water,
        node.longest_us,
        node.board.reset_cause,
        node.free_heap,
        node.sampler.clock.bound_us(),
        _charge(battery_mv),
    )
    node.outbox.post(HEALTH, HEALTH_SIZE)
    node.longest_us = 0
