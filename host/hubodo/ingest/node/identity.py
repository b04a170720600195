"""What a node says about itself, as text for the log."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from hubowire.messages import Hello, Part


def hello_metadata(hello: Hello) -> dict[str, str]:
    """What a node said about itself, as text for the log."""
    parts = [f"0x{at:02x} who_am_i 0x{who:02x} {_part(part)}" for at, who, part in hello.parts]
    return {
        "fingerprint": f"{hello.fingerprint:08x}",
        "firmware": ".".join(map(str, hello.firmware)),
        "serial": hello.serial.hex(),
        "boot_id": str(hello.boot_id),
        "rate_hz": f"{hello.rate_mhz / 1000:g}",
        "gyro_range_dps": str(hello.gyro_range_dps),
        "accel_range_g": str(hello.accel_range_g),
        "gyro_lsb_ndps": str(hello.gyro_lsb_ndps),
        "accel_lsb_ng": str(hello.accel_lsb_ng),
        "temperature_lsb_udegc": str(hello.temperature_lsb_udegc),
        "temperature_offset_udegc": str(hello.temperature_offset_udegc),
        "mag_lsb_ft": str(hello.mag_lsb_ft),
        "parts": "; ".join(parts),
    }


def firmware_difference(versions: Mapping[str, tuple[int, ...]]) -> str | None:
    """Return a line where nodes run different firmware; versions: by node name. None where all are alike."""
    if len(set(versions.values())) < 2:
        return None
    named = ", ".join(f"{node} {'.'.join(map(str, version))}" for node, version in sorted(versions.items()))
    return f"nodes run different firmware: {named}; bring them to one version with hubodo flash"


def known_name(codes: type[IntEnum], number: int) -> str:
    """A code's name in lower case; one that this version does not know as its number."""
    return codes(number).name.lower() if number in set(codes) else str(number)


def _part(number: int) -> str:
    return Part(number).name if number in set(Part) else "unknown"
