"""Radio links by nRF24L01+ or ESP-NOW through a receiver. A package, so that imports stay fast."""

from micropython import const

FIRST = const(0)
"""Number of the first ESP-NOW packet after a start; then 1 to LAST repeatedly."""
LAST = const(127)


def open_link(board):
    """Return the link to a receiver that the settings name."""
    if board.settings["link"] == "espnow":
        from radio import espnow_link

        return espnow_link.EspNowLink(board)
    from radio import radio_link

    return radio_link.RadioLink(board)


def open_air(board, outbox):
    """Return the receiving side of the radio that the settings name."""
    if board.settings["receiver"] == "espnow":
        from radio import espnow_air

        return espnow_air.EspNowAir(board, outbox)
    from radio import nrf24_air

    return nrf24_air.Nrf24Air(board, outbox)
