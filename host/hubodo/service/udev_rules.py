"""udev rules: device links `/dev/hubodo/<serial number>`, access for the group dialout, no ModemManager."""

from __future__ import annotations

RULES_FILE_NAME = "70-hubodo.rules"
"""The number sorts after 60-serial.rules of the system and before 77 and 80 of ModemManager."""

BOARDS: tuple[tuple[str, str, str], ...] = (
    ("2e8a", "0005", "MicroPython on a Pico"),
    ("303a", "1001", "USB of an ESP32-S3 or C3"),
    ("303a", "4001", "MicroPython on an ESP32-S3"),
    ("10c4", "ea60", "CP210x of an ESP32 board"),
    ("1a86", "7523", "CH340 of an ESP32 board"),
    ("1a86", "55d4", "CH9102 of an ESP32 board"),
    ("0403", "6001", "FTDI converter"),
    ("0403", "6015", "FTDI converter"),
)
"""USB vendor id, product id and description of each board."""


def rules_text() -> str:
    """Return the rules file; it keeps ModemManager from sending AT commands, which corrupt the link."""
    boards = [
        f'ATTRS{{idVendor}}=="{vendor}", ATTRS{{idProduct}}=="{product}", ENV{{HUBODO_BOARD}}="{description}"'
        for vendor, product, description in BOARDS
    ]
    devices = [
        f'SUBSYSTEM=="usb", ENV{{DEVTYPE}}=="usb_device", ATTR{{idVendor}}=="{vendor}", '
        f'ATTR{{idProduct}}=="{product}", ENV{{ID_MM_DEVICE_IGNORE}}="1"'
        for vendor, product, _ in BOARDS
    ]
    return "\n".join(
        [
            "# Written by `hubodo service install`.",
            'ACTION=="remove", GOTO="hubodo_end"',
            *devices,
            'SUBSYSTEM!="tty", GOTO="hubodo_end"',
            *boards,
            'ENV{HUBODO_BOARD}!="?*", GOTO="hubodo_end"',
            'ENV{ID_MM_DEVICE_IGNORE}="1", ENV{ID_MM_PORT_IGNORE}="1"',
            'GROUP="dialout", MODE="0660", TAG+="systemd"',
            'ENV{ID_SERIAL_SHORT}=="", IMPORT{builtin}="usb_id"',
            'ENV{ID_SERIAL_SHORT}=="?*", SYMLINK+="hubodo/$env{ID_SERIAL_SHORT}"',
            'LABEL="hubodo_end"',
            "",
        ]
    )
