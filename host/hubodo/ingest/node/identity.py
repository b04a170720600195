"""Identification of a node as text: log metadata, firmware versions, names of codes."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from hubodo.ingest.node.chip_identities import HIGH_G_BY_IDENTITY, MAG_BY_IDENTITY, imu_chip
from hubowire.messages import Hello, Part


def hello_metadata(hello: Hello) -> dict[str, str]:
    """Return the fields of a Hello as text for the log metadata."""
    parts = [
        f"{f'0x{at:02x}' if at else 'SPI'} who_am_i 0x{who:02x} {part_name(at, who, part)}"
        for at, who, part in hello.parts
    ]
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


def describe_firmware_difference(versions: Mapping[str, tuple[int, ...]]) -> str | None:
    """Return a warning if nodes run different firmware, else None; versions: firmware by node name."""
    if len(set(versions.values())) < 2:
        return None
    named = ", ".join(f"{node} {'.'.join(map(str, version))}" for node, version in sorted(versions.items()))
    return f"nodes run different firmware: {named}; update them to one version with hubodo flash"


def code_name(codes: type[IntEnum], number: int) -> str:
    """Return the name of a code in lower case; an unknown code as its number."""
    return codes(number).name.lower() if number in set(codes) else str(number)


def part_name(address: int, who_am_i: int, number: int) -> str:
    """Return the name of a chip of `Hello.parts`, or "unknown"."""
    if number in set(Part):
        return Part(number).name
    chip = imu_chip(address, who_am_i)
    others = MAG_BY_IDENTITY | HIGH_G_BY_IDENTITY
    return others.get((address, who_am_i), "unknown") if chip is None else chip.name
