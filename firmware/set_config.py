"""Executes a SetConfig request; loaded with the first one, with the table of settings."""

import settings
from drivers.chip import nearest
from wire import (
    BIAS_KIND_GRAVITY,
    CONFIG_KEY_ACCEL_RANGE_G,
    CONFIG_KEY_BIAS_KIND,
    CONFIG_KEY_FILTER_KIND,
    CONFIG_KEY_FORGETTING_Q20,
    CONFIG_KEY_GAIN_BIAS_Q30,
    CONFIG_KEY_GAIN_RATE_Q20,
    CONFIG_KEY_GYRO_RANGE_DPS,
    CONFIG_KEY_RATE_HZ,
    REASON_BAD_VALUE,
    REASON_NOT_STORED,
    SET_CONFIG,
)

_OF_FILTER = (
    CONFIG_KEY_FILTER_KIND,
    CONFIG_KEY_GAIN_RATE_Q20,
    CONFIG_KEY_GAIN_BIAS_Q30,
    CONFIG_KEY_FORGETTING_Q20,
)


def set_config(node, seq, key, value):
    """Change a setting of the node, store it, and answer the request."""
    commands = node.commands
    row = settings.remote(key)
    if row is None:
        commands.nack(SET_CONFIG, seq, REASON_BAD_VALUE, key)
        return
    _, name, least, most = row
    choices = _choices(node.parts.chip, key)
    # Without enough heap for both, the second accelerometer would be off after the next start.
    is_gravity = key == CONFIG_KEY_BIAS_KIND and value == BIAS_KIND_GRAVITY
    is_refused = is_gravity and node.settings.get("high_g_rate_hz")
    if (
        is_refused
        or not least <= value <= most
        or (choices is not None and nearest(choices, value)[0] != value)
    ):
        commands.nack(SET_CONFIG, seq, REASON_BAD_VALUE, value)
        return
    node.settings[name] = value
    try:
        settings.store(node.settings)
    except OSError:
        commands.nack(SET_CONFIG, seq, REASON_NOT_STORED, value)
    else:
        commands.ack(SET_CONFIG, seq)
    node.outbox.node_id = node.settings["node_id"]
    if key in _OF_FILTER:
        node.new_filter()


def _choices(chip, key):
    """Return the table of the chip that lists the allowed values of a ConfigKey, or None."""
    if chip is None:
        return None
    if key == CONFIG_KEY_RATE_HZ:
        return chip.RATES_HZ
    if key == CONFIG_KEY_GYRO_RANGE_DPS:
        return chip.RANGES_DPS
    return chip.RANGES_G if key == CONFIG_KEY_ACCEL_RANGE_G else None
