"""Settings of the radio and of rest; loaded where /config.json has one of them that matters."""

DEFAULTS = {
    "receiver": "",  # nrf24, espnow: this board passes on what nodes send by radio
    "radio_nodes": [1, 2],  # whom a receiver listens to, at most five
    "radio_channel": 76,  # 2400 MHz and so many
    "radio_kbps": 1000,  # 250, 1000 or 2000
    "radio_tries": 15,  # repeats of a packet that is not acknowledged
    "radio_address": "e8b7d6a5",  # of the net; a byte for the node comes behind
    "espnow_channel": 1,  # of Wi-Fi, 1 to 13
    "rest_after_s": 0,  # at rest for so long: samples at rest_rate_hz; 0 = never
    "rest_rate_hz": 26,
    "rest_mg": 60,  # a change of the acceleration that is motion
    "rest_dps": 3,  # of the angular rate
}

# As in settings: (0, name, least, most). What is out of them is the least.
BOUNDS = (
    (0, "radio_channel", 0, 125),
    (0, "radio_tries", 0, 15),
    (0, "espnow_channel", 1, 13),
    (0, "rest_after_s", 0, 86400),
    (0, "rest_rate_hz", 13, 104),
    (0, "rest_mg", 10, 1000),
    (0, "rest_dps", 1, 100),
)
