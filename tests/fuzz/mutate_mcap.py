"""MCAP files changed where they mean something: records, their fields, their texts, the inside of chunks."""

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
    """Records of a file or a chunk, as far as their lengths make sense."""
    found, at = [], 0
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        if at + 9 + length > len(data):
            break
        found.append((opcode, data[at + 9 : at + 9 + length]))
        at += 9 + length
    return found


def joined(records: list[Record]) -> bytes:
    return b"".join(struct.pack("<BQ", opcode, len(content)) + content for opcode, content in records)


def mutated(rng: random.Random, data: bytes) -> bytes:
    """A file of which some records are changed; checksums are made right or left out, so that it is read."""
    if rng.random() < 0.15:
        return bytes(torn(rng, data))
    records = split(data[len(MAGIC) : -len(MAGIC)])
    # Without a summary, so that what stands in the records counts.
    records = [record for record in records[: _end(records)] if record[0] != DATA_END]
    for _ in range(rng.randint(1, 4)):
        _change(rng, records)
    records += [(DATA_END, bytes(4)), (FOOTER, bytes(20))]
    return MAGIC + joined(records) + (MAGIC if rng.random() < 0.9 else b"")


def torn(rng: random.Random, data: bytes) -> bytearray:
    """Bytes changed, cut out or doubled anywhere."""
    made = bytearray(data)
    for _ in range(rng.randint(1, 6)):
        at, size = rng.randrange(len(made) or 1), rng.choice((1, 4, 8, 60, 500))
        way = rng.randrange(4)
        if way == 0 and made:
            made[at] = rng.randrange(256)
        elif way == 1:
            del made[at : at + size]
        elif way == 2:
            made[at:at] = made[at : at + size]
        else:
            made[at : at + 8] = struct.pack("<Q", rng.choice(NUMBERS))[: rng.choice((1, 2, 4, 8))]
    return made


def _end(records: list[Record]) -> int:
    return next((i for i, (opcode, _) in enumerate(records) if opcode == DATA_END), len(records))


def _change(rng: random.Random, records: list[Record]) -> None:
    if not records:
        return
    at = rng.randrange(len(records))
    opcode, content = records[at]
    way = rng.random()
    if way < 0.06:
        del records[at]
    elif way < 0.12:
        records.insert(rng.randrange(len(records) + 1), records[at])
    elif way < 0.16:
        other = rng.randrange(len(records))
        records[at], records[other] = records[other], records[at]
    elif way < 0.19:
        records[at] = (rng.randrange(1, 0x12), content)
    elif opcode == SCHEMA and way < 0.9:
        records[at] = (opcode, _retyped(rng, content))
    elif opcode == CHUNK and way < 0.95:
        records[at] = (opcode, _rechunked(rng, content))
    else:
        records[at] = (opcode, _field(rng, content))
    if at < len(records) and records[at][0] == ATTACHMENT:
        body = records[at][1][:-4]
        records[at] = (ATTACHMENT, body + struct.pack("<I", zlib.crc32(body)))


def _retyped(rng: random.Random, content: bytes) -> bytes:
    """The schema with the name of another type, or with a definition that is cut off or not text."""
    try:
        (size,) = struct.unpack_from("<I", content, 2)
        name, rest = content[6 : 6 + size], content[6 + size :]
        (size,) = struct.unpack_from("<I", rest)
        encoding, text = rest[4 : 4 + size], rest[8 + size :]
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
    """The chunk with changed messages in it, in another compression as it comes."""
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
    plain = joined(inside)
    name = rng.choice(("zstd", "lz4", ""))
    packed = {"zstd": zstandard.ZstdCompressor(level=1).compress, "lz4": lz4.frame.compress}.get(name, bytes)(
        plain
    )
    head = struct.pack("<QQQII", start, end, len(plain), 0, len(name))
    return head + name.encode() + struct.pack("<Q", len(packed)) + packed


def _change_inside(rng: random.Random, records: list[Record]) -> None:
    if not records:
        return
    at, way = rng.randrange(len(records)), rng.random()
    opcode, content = records[at]
    if way < 0.05:
        del records[at]
    elif way < 0.1:
        records.insert(at, records[at])
    elif way < 0.15:
        other = rng.randrange(len(records))
        records[at], records[other] = records[other], records[at]
    else:
        records[at] = (opcode, _field(rng, content))


def _field(rng: random.Random, content: bytes) -> bytes:
    """One field of a record: a number, a double, a length, a bit of text or of JSON."""
    made = bytearray(content)
    if not made:
        return bytes(rng.randrange(9))
    at, way = rng.randrange(len(made)), rng.random()
    if way < 0.3:
        size = rng.choice((1, 2, 4, 8))
        made[at : at + size] = (rng.choice(NUMBERS) & ((1 << 8 * size) - 1)).to_bytes(size, "little")
    elif way < 0.5:
        # Doubles of CDR stand at multiples of eight behind the head of the message.
        at = min(len(made), 22 + 4 + 8 * rng.randrange(max(1, (len(made) - 26) // 8)))
        made[at : at + 8] = struct.pack("<d", rng.choice(DOUBLES))
    elif way < 0.6:
        del made[at : at + rng.choice((1, 4, 8, 100))]
    elif way < 0.7:
        made[at:at] = bytes(rng.choice((1, 4, 8, 100)))
    elif way < 0.85 and b":" in made:
        places = [i for i, byte in enumerate(made) if byte == ord(":")]
        place = rng.choice(places)
        stop = next((i for i in range(place, len(made)) if made[i] in b",}"), len(made))
        made[place + 1 : stop] = rng.choice(JSON)
        if len(content) > 22:
            return bytes(made)
    else:
        made[at] ^= 1 << rng.randrange(8)
    return bytes(made)
