"""Settings of the node in /config.json, with defaults and bounds."""

import json

from wire import (
    BIAS_KIND_GRAVITY,
    BIAS_KIND_MEAN,
    CONFIG_KEY_ACCEL_RANGE_G,
    CONFIG_KEY_BATCH,
    CONFIG_KEY_BIAS_KIND,
    CONFIG_KEY_FILTER_KIND,
    CONFIG_KEY_FORGETTING_Q20,
    CONFIG_KEY_GAIN_BIAS_Q30,
    CONFIG_KEY_GAIN_RATE_Q20,
    CONFIG_KEY_GYRO_RANGE_DPS,
    CONFIG_KEY_NODE_ID,
    CONFIG_KEY_RATE_HZ,
    CONFIG_KEY_TABLE_RATE_UDPS,
    FILTER_KIND_KALMAN,
    FILTER_KIND_RLS,
    UART_BAUD,
)

PATH = "/config.json"

DEFAULTS = {
    "node_id": 1,
    "link": "usb",  # usb, uart, udp, ble, nrf24 or espnow
    "rate_hz": 416,
    "gyro_range_dps": 2000,
    "accel_range_g": 16,
    "fifo": True,  # samples through the chip's FIFO; otherwise polled, up to 250 Hz
    "batch": 0,  # samples per ImuBatch; 0 = 8 up to 250 Hz, 16 above
    "mag_rate_hz": 10,  # 0 = magnetometer off
    "filter_kind": FILTER_KIND_KALMAN,
    "gain_rate_q20": 314573,
    "gain_bias_q30": 322,
    "forgetting_q20": 1027604,  # lambda of the RLS filter: 0.98
    "bias_kind": BIAS_KIND_MEAN,
    "bias_stretch": 0,  # samples per mean of the pseudo-measurement; 0 = 16; gravity: 512, above 250 Hz 1024
    "table_rate_udps": 0,
    "noise_udps": 75000,  # 1 sigma of a gyro sample
    "bias_sigma_udps": 5000000,  # 1 sigma of the initial bias
    "phase_mrad": 20,  # 1 sigma of the direction of gravity in a sample
    "wheel_radius_mm": 0,
    "arm_mm": [],  # lever arm x, y
    "gyro_scale_ppm": 0,  # scale error of the z gyro
    "gyro_scale_sigma_ppm": 10000,
    "bias_udps": [],  # bias of x, y, z, without the warm-up
    "warmup_udps": [],  # warm-up drift C1 of x, y, z
    "warmup_s": 3600,  # its time constant T
    "warmup_second": [],  # C1 of x, y, z and T of a second exponential
    "filter_period_ms": 200,
    "queue": 24,
    "watchdog": True,
    "low_battery_mv": 3300,
    "baud": UART_BAUD,
    "ssid": "",
    "password": "",
    "host": "",
    "port": 47110,
    "key": "",  # key of authenticated UDP or BLE, 64 hexadecimal digits
    "pins": {},
}

# (ConfigKey, 0 for settings that only the file sets; name; lowest; highest)
BOUNDS = (
    (CONFIG_KEY_NODE_ID, "node_id", 1, 254),
    (CONFIG_KEY_RATE_HZ, "rate_hz", 1, 2000),
    (CONFIG_KEY_GYRO_RANGE_DPS, "gyro_range_dps", 125, 4000),
    (CONFIG_KEY_ACCEL_RANGE_G, "accel_range_g", 2, 24),
    (CONFIG_KEY_BATCH, "batch", 0, 19),
    (CONFIG_KEY_FILTER_KIND, "filter_kind", 0, FILTER_KIND_RLS),
    (CONFIG_KEY_GAIN_RATE_Q20, "gain_rate_q20", 0, 1048575),
    (CONFIG_KEY_GAIN_BIAS_Q30, "gain_bias_q30", 0, 1048575),
    (CONFIG_KEY_FORGETTING_Q20, "forgetting_q20", 524288, 1047552),
    (CONFIG_KEY_BIAS_KIND, "bias_kind", 0, BIAS_KIND_GRAVITY),
    (CONFIG_KEY_TABLE_RATE_UDPS, "table_rate_udps", 0, 1000000000),
    (0, "bias_stretch", 0, 1024),
    (0, "noise_udps", 1000, 10000000),
    (0, "bias_sigma_udps", 1000, 30000000),
    (0, "phase_mrad", 1, 1000),
    (0, "wheel_radius_mm", 0, 10000),
    (0, "gyro_scale_ppm", -200000, 200000),
    (0, "gyro_scale_sigma_ppm", 0, 200000),
    (0, "warmup_s", 10, 100000),
    (0, "baud", 9600, 3000000),
)

# (name, number of values or none at all, largest magnitude)
_LISTS = (
    ("arm_mm", 2, 1000),
    ("bias_udps", 3, 30000000),
    ("warmup_udps", 3, 30000000),
    ("warmup_second", 4, 30000000),
)


def load(path=PATH):
    """Return the defaults overlaid by the file; what is unreadable or out of bounds there is ignored."""
    values: dict = dict(DEFAULTS)
    bounds: tuple = BOUNDS
    try:
        with open(path) as file:
            stored = json.load(file)
    except (OSError, ValueError):
        return values
    if isinstance(stored, dict):
        more = stored.get("receiver") or stored.get("rest_after_s") or stored.get("park_after_s")
        more = more or stored.get("high_g_rate_hz")
        if more or stored.get("link") in ("nrf24", "espnow"):
            import settings_more

            values.update(settings_more.DEFAULTS)
            bounds += settings_more.BOUNDS
        for name in stored:
            if name in values and type(stored[name]) is type(values[name]):
                values[name] = stored[name]
    for _, name, least, most in bounds:
        if not least <= values[name] <= most:
            values[name] = least if name not in DEFAULTS else DEFAULTS[name]
    for name, count, most in _LISTS:
        row = values[name]
        if row and (len(row) != count or not all(type(x) is int and -most <= x <= most for x in row)):
            values[name] = []
    if values["warmup_udps"] or values["bias_kind"] == BIAS_KIND_GRAVITY:
        values.pop("high_g_rate_hz", None)  # 8 kB of heap would not be left
    return values


def store(values, path=PATH):
    """Write what differs from the defaults. Raises OSError when the file cannot be written."""
    changed = {}
    for name in values:
        if values[name] != DEFAULTS.get(name):
            changed[name] = values[name]
    with open(path, "w") as file:
        json.dump(changed, file)


def remote(key):
    """Return the row of BOUNDS for a ConfigKey, or None."""
    for row in BOUNDS:
        if key and row[0] == key:
            return row
    return None
