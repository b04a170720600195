"""Mutate MCAP files at meaningful places: records, fields, texts, contents of chunks."""

from __future__ import annotations

import random
import struct
import zlib

import lz4.frame
import zstandard

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHUNK, ATTACHMENT, DATA_END, FOOTER = 3, 6, 9, 15, 2
TYPES = (
    b"sensor_msgs/msg/Imu", b"sensor_msgs/msg/JointState", b"nav_msgs/msg/Odometry",
    b"sensor_msgs/msg/NavSatFix", b"std_msgs/msg/Float64MultiArray", b"sensor_msgs/msg/Temperature",
    b"std_msgs/msg/String", b"x", b"",
)  # fmt: skip
NUMBERS = (
    0,
    1,
    0x7F,
    0x80,
    0xFF,
    0xFFFF,
    1 << 31,
    (1 << 31) - 1,
    1 << 32,
    1 << 53,
    1 << 62,
    1 << 63,
    (1 << 64) - 1,
)
DOUBLES = (float("nan"), float("inf"), float("-inf"), 1e300, -1e300, 5e-324, -0.0, 1e154, 0.0)
JSON = (
    b"NaN",
    b"Infinity",
    b"-Infinity",
    b"1e999",
    b"null",
    b"[]",
    b"{}",
    b'""',
    b"-1",
    b"9" * 40,
    b"true",
    b"[" * 3000,
)

Record = tuple[int, bytes]


def split(data: bytes) -> list[Record]:
    """Split a file or chunk into records, as far as their lengths are valid."""
    records, at = [], 0
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        if at + 9 + length > len(data):
            break
        records.append((opcode, data[at + 9 : at + 9 + length]))
        at += 9 + length
    return records


def join_records(records: list[Record]) -> bytes:
    return b"".join(struct.pack("<BQ", opcode, len(content)) + content for opcode, content in records)


def mutated(rng: random.Random, data: bytes) -> bytes:
    """Return a file with some changed records, with valid or absent checksums so that it is read."""
    if rng.random() < 0.15:
        return bytes(torn(rng, data))
    records = split(data[len(MAGIC) : -len(MAGIC)])
    # The file gets no summary, so that readers use the records themselves.
    records = [record for record in records[: _end(records)] if record[0] != DATA_END]
    for _ in range(rng.randint(1, 4)):
        _change(rng, records)
    records += [(DATA_END, bytes(4)), (FOOTER, bytes(20))]
    return MAGIC + join_records(records) + (MAGIC if rng.random() < 0.9 else b"")


def torn(rng: random.Random, data: bytes) -> bytearray:
    """Return data with bytes changed, removed or repeated anywhere."""
    changed = bytearray(data)
    for _ in range(rng.randint(1, 6)):
        at, size = rng.randrange(len(changed) or 1), rng.choice((1, 4, 8, 60, 500))
        choice = rng.randrange(4)
        if choice == 0 and changed:
            changed[at] = rng.randrange(256)
        elif choice == 1:
            del changed[at : at + size]
        elif choice == 2:
            changed[at:at] = changed[at : at + size]
        else:
            changed[at : at + 8] = struct.pack("<Q", rng.choice(NUMBERS))[: rng.choice((1, 2, 4, 8))]
    return changed


def _end(records: list[Record]) -> int:
    return next((i for i, (opcode, _) in enumerate(records) if opcode == DATA_END), len(records))


def _change(rng: random.Random, records: list[Record]) -> None:
    if not records:
        return
    at = rng.randrange(len(records))
    opcode, content = records[at]
    choice = rng.random()
    if choice < 0.06:
        del records[at]
    elif choice < 0.12:
        records.insert(rng.randrange(len(records) + 1), records[at])
    elif choice < 0.16:
        other = rng.randrange(len(records))
        records[at], records[other] = records[other], records[at]
    elif choice < 0.19:
        records[at] = (rng.randrange(1, 0x12), content)
    elif opcode == SCHEMA and choice < 0.9:
        records[at] = (opcode, _retyped(rng, content))
    elif opcode == CHUNK and choice < 0.95:
        records[at] = (opcode, _rechunked(rng, content))
    else:
        records[at] = (opcode, _field(rng, content))
    if at < len(records) and records[at][0] == ATTACHMENT:
        body = records[at][1][:-4]
        records[at] = (ATTACHMENT, body + struct.pack("<I", zlib.crc32(body)))


def _retyped(rng: random.Random, content: bytes) -> bytes:
    """Return the schema with the name of another type or a damaged definition."""
    try:
        (size,) = struct.unpack_from("<I", content, 2)
        name, remainder = content[6 : 6 + size], content[6 + size :]
        (size,) = struct.unpack_from("<I", remainder)
        encoding, text = remainder[4 : 4 + size], remainder[8 + size :]
    except struct.error:
        return content
    if rng.random() < 0.5:
        name = rng.choice(TYPES)
    else:
        text = rng.choice(
            (text[: rng.randrange(len(text) + 1)], b"float64[" + b"9" * 5000 + b"] x", b"\xff", b"")
        )
    parts = b"".join(struct.pack("<I", len(part)) + part for part in (name, encoding, text))
    return content[:2] + parts


def _rechunked(rng: random.Random, content: bytes) -> bytes:
    """Return the chunk with changed messages, in a random compression."""
    try:
        start, end, _, _, length = struct.unpack_from("<QQQII", content)
        name = content[32 : 32 + length].decode()
        body = content[32 + length + 8 :]
        plain = {"zstd": zstandard.ZstdDecompressor().decompress, "lz4": lz4.frame.decompress}.get(
            name, bytes
        )(body)
    except (struct.error, ValueError, RuntimeError, zstandard.ZstdError):
        return content
    inside = split(plain)
    for _ in range(rng.randint(1, 5)):
        _change_inside(rng, inside)
    plain = join_records(inside)
    name = rng.choice(("zstd", "lz4", ""))
    packed = {"zstd": zstandard.ZstdCompressor(level=1).compress, "lz4": lz4.frame.compress}.get(name, bytes)(
        plain
    )
    head = struct.pack("<QQQII", start, end, len(plain), 0, len(name))
    return head + name.encode() + struct.pack("<Q", len(packed)) + packed


def _change_inside(rng: random.Random, records: list[Record]) -> None:
    if not records:
        return
    at, choice = rng.randrange(len(records)), rng.random()
    opcode, content = records[at]
    if choice < 0.05:
        del records[at]
    elif choice < 0.1:
        records.insert(at, records[at])
    elif choice < 0.15:
        other = rng.randrange(len(records))
        records[at], records[other] = records[other], records[at]
    else:
        records[at] = (opcode, _field(rng, content))


def _field(rng: random.Random, content: bytes) -> bytes:
    """Change one field of a record: a number, a double, a length, text or JSON."""
    changed = bytearray(content)
    if not changed:
        return bytes(rng.randrange(9))
    at, choice = rng.randrange(len(changed)), rng.random()
    if choice < 0.3:
        size = rng.choice((1, 2, 4, 8))
        changed[at : at + size] = (rng.choice(NUMBERS) & ((1 << 8 * size) - 1)).to_bytes(size, "little")
    elif choice < 0.5:
        # Doubles of CDR stand at multiples of eight behind the head of the message.
        at = min(len(changed), 22 + 4 + 8 * rng.randrange(max(1, (len(changed) - 26) // 8)))
        changed[at : at + 8] = struct.pack("<d", rng.choice(DOUBLES))
    elif choice < 0.6:
        del changed[at : at + rng.choice((1, 4, 8, 100))]
    elif choice < 0.7:
        changed[at:at] = bytes(rng.choice((1, 4, 8, 100)))
    elif choice < 0.85 and b":" in changed:
        places = [i for i, byte in enumerate(changed) if byte == ord(":")]
        place = rng.choice(places)
        stop = next((i for i in range(place, len(changed)) if changed[i] in b",}"), len(changed))
        changed[place + 1 : stop] = rng.choice(JSON)
        if len(content) > 22:
            return bytes(changed)
    else:
        changed[at] ^= 1 << rng.randrange(8)
    return bytes(changed)
