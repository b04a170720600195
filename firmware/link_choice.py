"""Opens the link that the settings name; loaded at the start alone."""

import sys

import machine
from micropython import const

_UART_BUFFER = const(512)
_PACKET_LINKS = (("udp", "wifi", "UdpLink"), ("ble", "ble", "BleLink"))
"""(name in the settings, module, class) of the links that a key may seal."""


def open_link(board):
    """Return the link of the board's settings; other links are not loaded."""
    settings = board.settings
    kind = settings["link"]
    if kind == "uart":
        return _open_uart(settings["baud"], board.pins)
    if kind == "nrf24":
        from radio import radio_link

        return radio_link.RadioLink(board)
    if kind == "espnow":
        from radio import espnow_link

        return espnow_link.EspNowLink(board)
    for name, module, its_class in _PACKET_LINKS:
        if kind == name:
            carrier = getattr(__import__(module), its_class)(settings)
            if not settings["key"]:
                return carrier
            import sealed

            return sealed.SealedLink(carrier, settings["key"])
    if sys.platform == "esp32":
        import uart

        return uart.ConsoleLink()
    import link

    return link.UsbLink()


def _open_uart(baud, pins):
    import uart

    port = machine.UART(
        pins["uart"],
        baud,
        tx=machine.Pin(pins["tx"]),
        rx=machine.Pin(pins["rx"]),
        txbuf=_UART_BUFFER,
        rxbuf=_UART_BUFFER,
        timeout=0,
    )
    return uart.UartLink(port, baud, _UART_BUFFER)
