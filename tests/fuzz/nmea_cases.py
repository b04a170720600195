"""NMEA sentences with changed fields and valid checksums, as of a broken or hostile receiver."""

from __future__ import annotations

import random

from fuzz.case import Case
from fuzz.mutate_mcap import torn
from fuzz.seeds import NMEA
from fuzz.settings import SETTINGS

FIELDS = (
    b"nan", b"inf", b"-inf", b"1e200", b"1e-400", b"", b" ", b"9" * 400, b"9" * 5000, b"-1", b"0", b"91",
    b"4860.000",
    b"18100.000", b"-4807.038", b"4807.0.38", b"0x10", b"1_0", b"N", b"S", b"Q", b"V", b"A", b"n",
    b"\xd9\xa3", b"\xff\xfe",
    b"320199", b"000000", b"310299", b"999999", b"235960.00", b"246060", b"120000.999999999999", b"-00001",
    b"1" * 6, b"*",
    b"$", b"\x00", b"\x1b[2J", b"99999999999999999999", b"1.7976931348623157e308",
)  # fmt: skip
TALKERS = (b"GP", b"GN", b"GL", b"GA", b"BD", b"Q1", b"P", b"\xc3\xa9", b"")


def mutated_sentence(rng: random.Random, sentence: bytes) -> bytes:
    """Change fields of a sentence; its checksum is valid afterwards."""
    fields = sentence.strip().lstrip(b"$").partition(b"*")[0].split(b",")
    for _ in range(rng.randint(1, 4)):
        place, choice = rng.randrange(len(fields)), rng.random()
        if choice < 0.7:
            fields[place] = rng.choice(FIELDS)
        elif choice < 0.78:
            fields.insert(place, rng.choice(FIELDS))
        elif choice < 0.86 and len(fields) > 1:
            del fields[place]
        elif choice < 0.93:
            other = rng.randrange(len(fields))
            fields[place], fields[other] = fields[other], fields[place]
        else:
            fields[0] = rng.choice(TALKERS) + rng.choice(
                (b"GGA", b"RMC", b"GST", b"HDT", b"VTG", b"ZDA", b"gga")
            )
    body = b",".join(fields)
    checksum = 0
    for byte in body:
        checksum ^= byte
    digits = f"{checksum:02X}" if rng.random() < 0.9 else f"{checksum:02x}"
    return b"$" + body + b"*" + digits.encode() + rng.choice((b"\r\n", b"\r\n", b"\n", b"\r"))


def sentences(rng: random.Random, count: int) -> list[bytes]:
    """Return `count` changed sentences; every fifth is a valid one, so that a receiver's state matters."""
    lines = NMEA.splitlines(keepends=True)
    return [
        rng.choice(lines) if rng.random() < 0.2 else mutated_sentence(rng, rng.choice(lines))
        for _ in range(count)
    ]


def nmea_case(rng: random.Random) -> Case:
    """A receiver's stream: changed sentences with valid checksums, or bytes changed on the line."""
    data = b"".join(sentences(rng, 12)) if rng.random() < 0.7 else bytes(torn(rng, NMEA * 3))
    return Case(("frames", str(rng.randrange(1 << 30)), "gnss"), {"stream": data, **SETTINGS})
