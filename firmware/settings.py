"""/config.json: the node's settings with their defaults and bounds."""

import json

from wire import (
    CONFIG_KEY_ACCEL_RANGE_G,
    CONFIG_KEY_BATCH,
    CONFIG_KEY_FILTER_KIND,
    CONFIG_KEY_GAIN_BIAS_Q30,
    CONFIG_KEY_GAIN_RATE_Q20,
    CONFIG_KEY_GYRO_RANGE_DPS,
    CONFIG_KEY_NODE_ID,
    CONFIG_KEY_RATE_HZ,
    FILTER_KIND_KALMAN,
    FILTER_KIND_RLS,
)

PATH = "/config.json"

DEFAULTS = {
    "node_id": 1,
    "link": "usb",  # usb, uart or udp
    "rate_hz": 208,
    "gyro_range_dps": 2000,
    "accel_range_g": 16,
    "fifo": False,  # samples through the chip's FIFO below 250 Hz too
    "batch": 0,  # samples per ImuBatch; 0 = 8 up to 250 Hz, 16 above
    "mag_rate_hz": 10,  # 0 = the magnetometer stays off
    "filter_kind": FILTER_KIND_KALMAN,
    "gain_rate_q20": 314573,
    "gain_bias_q30": 322,
    "filter_period_ms": 200,
    "queue": 24,
    "watchdog": True,
    "low_battery_mv": 3300,
    "baud": 921600,
    "ssid": "",
    "password": "",
    "host": "",
    "port": 47110,
    "pins": {},
}

# (ConfigKey, name, least, most)
REMOTE = (
    (CONFIG_KEY_NODE_ID, "node_id", 1, 254),
    (CONFIG_KEY_RATE_HZ, "rate_hz", 1, 1660),
    (CONFIG_KEY_GYRO_RANGE_DPS, "gyro_range_dps", 125, 2000),
    (CONFIG_KEY_ACCEL_RANGE_G, "accel_range_g", 2, 16),
    (CONFIG_KEY_BATCH, "batch", 0, 19),
    (CONFIG_KEY_FILTER_KIND, "filter_kind", 0, FILTER_KIND_RLS),
    (CONFIG_KEY_GAIN_RATE_Q20, "gain_rate_q20", 0, 1048575),
    (CONFIG_KEY_GAIN_BIAS_Q30, "gain_bias_q30", 0, 1048575),
)


def load(path=PATH):
    """The defaults, overlaid by the file; what cannot be read or is out of bounds there is passed over."""
    values: dict = dict(DEFAULTS)
    try:
        with open(path) as file:
            stored = json.load(file)
    except (OSError, ValueError):
        return values
    if isinstance(stored, dict):
        for name in stored:
            if name in values and type(stored[name]) is type(values[name]):
                values[name] = stored[name]
    for _, name, least, most in REMOTE:
        if not least <= values[name] <= most:
            values[name] = DEFAULTS[name]
    return values


def store(values, path=PATH):
    """Writes what differs from the defaults; raises OSError when the file cannot be written."""
    changed = {}
    for name in values:
        if values[name] != DEFAULTS.get(name):
            changed[name] = values[name]
    with open(path, "w") as file:
        json.dump(changed, file)


def remote(key):
    """The row of REMOTE for a ConfigKey, or None."""
    for row in REMOTE:
        if row[0] == key:
            return row
    return None
