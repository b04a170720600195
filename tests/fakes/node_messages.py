"""Messages of a node with typical values, which tests change where they need to."""

from dataclasses import replace

from hubowire import FINGERPRINT
from hubowire.messages import Health, Hello

_HELLO = Hello(
    fingerprint=FINGERPRINT,
    firmware=(1, 4, 2),
    serial=bytes.fromhex("0011223344556677"),
    boot_id=4711,
    board=3,
    reset_cause=1,
    rate_mhz=416_000,
    gyro_range_dps=2000,
    accel_range_g=16,
    gyro_lsb_ndps=70_000_000,
    accel_lsb_ng=488_000,
    temperature_lsb_udegc=62_500,
    temperature_offset_udegc=25_000_000,
    mag_lsb_ft=0,
    batch=16,
    filter_kind=0,
    stamp_bound_us=40,
    parts=((0x6B, 0x69, 1),),
)
_HEALTH = Health(
    t_us=1_000_000,
    battery_mv=3700,
    faults=0,
    i2c_errors=0,
    bus_recoveries=0,
    fifo_overruns=0,
    samples_missed=0,
    frames_dropped=0,
    frames_damaged=0,
    queue_high_water=1,
    worst_loop_us=900,
    reset_cause=1,
    free_heap=50_000,
    stamp_bound_us=40,
)


def hello(**changes: object) -> Hello:
    """Return the Hello of an LSM6DS33 on a Pico at 416 Hz."""
    return replace(_HELLO, **changes)  # type: ignore[arg-type]


def health(**changes: object) -> Health:
    """Return the report of a healthy node."""
    return replace(_HEALTH, **changes)  # type: ignore[arg-type]
