"""Settings of radio, standstill and second accelerometer; loaded where /config.json enables one of these."""

DEFAULTS = {
    "receiver": "",  # nrf24, espnow: this board forwards what nodes send by radio
    "radio_nodes": [1, 2],  # nodes that a receiver forwards, at most five
    "radio_channel": 76,  # MHz above 2400 MHz
    "radio_kbps": 1000,  # 250, 1000 or 2000
    "radio_tries": 15,  # repeats of a packet that is not acknowledged
    "radio_address": "e8b7d6a5",  # address of the network; on the air a byte for the node follows
    "espnow_channel": 1,  # of Wi-Fi, 1 to 13
    "rest_after_s": 0,  # after this time at standstill: samples at rest_rate_hz; 0 = never
    "park_after_s": 0,  # after this time at standstill: asleep until motion; 0 = never
    "high_g_rate_hz": 0,  # 100, 200 or 400: an ADXL375 beside the IMU; 0 = none
    "rest_rate_hz": 26,
    "rest_mg": 60,  # change of acceleration that counts as motion
    "rest_dps": 3,  # change of angular rate that counts as motion
}

# As in settings: (0, name, lowest, highest). A value out of bounds becomes the lowest.
BOUNDS = (
    (0, "radio_channel", 0, 125),
    (0, "radio_tries", 0, 15),
    (0, "espnow_channel", 1, 13),
    (0, "rest_after_s", 0, 86400),
    (0, "park_after_s", 0, 86400),
    (0, "high_g_rate_hz", 0, 400),
    (0, "rest_rate_hz", 13, 104),
    (0, "rest_mg", 10, 1000),
    (0, "rest_dps", 1, 100),
)
