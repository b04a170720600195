"""Add a test vector to protocol/vectors: bytes of a stream and the expected result of a decoder.

The framing is independent of hubowire: PyPI `cobs` and CPython's `binascii.crc_hqx`.

    tools/new_vector.py message Nack 'wheel turns' --set request=70 --set reason=3 --set detail=412
    tools/new_vector.py stream bad_crc 'second byte flipped' 0642010151e70300 --origin 'by hand from ...'
"""

import argparse
import ast
import binascii
import dataclasses
import json
import struct
import sys
from pathlib import Path
from typing import Any

from cobs import cobs

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "protocol"))

from hubowire import MESSAGES, FrameDecoder, Message, PayloadError, decode, encode  # noqa: E402
from hubowire.messages import upper_snake, wire_fields  # noqa: E402

VECTORS = ROOT / "protocol" / "vectors"
FOREIGN_FRAMING = "fields packed by hubowire; framed by PyPI cobs and binascii.crc_hqx"


def foreign_frame(type_id: int, node: int, seq: int, payload: bytes) -> bytes:
    """Return a frame with its delimiter, built by libraries that hubowire does not use."""
    body = struct.pack("<BBH", type_id, node, seq) + payload
    checked = body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))
    return bytes(cobs.encode(checked)) + b"\0"


def values_as_json(message: Message) -> dict[str, Any]:
    """Return field values with bytes as hex and tables as lists."""
    values = dataclasses.asdict(message)  # type: ignore[call-overload]
    return {name: value.hex() if isinstance(value, bytes) else value for name, value in values.items()}


def message_vector(name: str, message: Message, node: int, seq: int, origin: str) -> dict[str, Any]:
    """Return a vector of one frame that carries `message`."""
    stream = foreign_frame(message.type_id, node, seq, encode(message))
    return stream_vector(name, stream, origin)


def stream_vector(name: str, stream: bytes, origin: str) -> dict[str, Any]:
    """Return a vector of any bytes. The expectation is the present result of hubowire: review it."""
    decoder = FrameDecoder()
    frames = []
    for frame in decoder.feed(stream):
        header = {"type": frame.type_id, "node": frame.node, "seq": frame.seq, "payload": frame.payload.hex()}
        try:
            message = decode(frame.type_id, frame.payload)
        except PayloadError:
            frames.append({**header, "message": None, "values": None, "malformed": True})
            continue
        kind = type(message).__name__ if message else None
        frames.append({**header, "message": kind, "values": values_as_json(message) if message else None})
    return {
        "name": name,
        "origin": origin,
        "stream": stream.hex(),
        "frames": frames,
        "damage": dataclasses.asdict(decoder.damage),
        "idle_delimiters": decoder.idle_delimiters,
        "pending": decoder.pending_bytes,
    }


def add_vector(file: Path, vector: dict[str, Any]) -> None:
    """Append to a file of vectors, or replace the one of the same name."""
    vectors = json.loads(file.read_text(encoding="utf-8")) if file.exists() else []
    others = [old for old in vectors if old["name"] != vector["name"]]
    text = json.dumps([*others, vector], indent=1)
    file.write_text(text + "\n", encoding="utf-8")


def parse_message(kind: str, settings: list[str]) -> Message:
    """Return a message with the given fields, zeros elsewhere.

    Raises ValueError when there is no such message, field or value.
    """
    by_name = {message.__name__: message for message in MESSAGES}
    if kind not in by_name:
        raise ValueError(f"no message {kind!r}: there are {', '.join(by_name)}")
    values: dict[str, Any] = {}
    for row in wire_fields(by_name[kind]):
        count = int(row.type.removesuffix("[]")[:-1] or 1)
        if row.is_table:
            values[row.name] = ()
        elif row.type.endswith("s"):
            values[row.name] = bytes(count)
        else:
            values[row.name] = (0,) * count if count > 1 else 0
    for setting in settings:
        name, _, text = setting.partition("=")
        if name not in values:
            raise ValueError(f"{kind} has no field {name!r}: there are {', '.join(values)}")
        old = values[name]
        values[name] = bytes.fromhex(text) if isinstance(old, bytes) else ast.literal_eval(text)
    return by_name[kind](**values)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    kinds = parser.add_subparsers(dest="kind", required=True)
    message_options = kinds.add_parser("message", help="one frame with one message, into <message>.json")
    message_options.add_argument("type", help="class name in hubowire.messages")
    message_options.add_argument("name", help="what distinguishes this vector")
    message_options.add_argument(
        "--set", action="append", default=[], metavar="FIELD=VALUE", help="a field; the others are zero"
    )
    message_options.add_argument("--node", type=int, default=1)
    message_options.add_argument("--seq", type=int, default=0)
    message_options.add_argument("--origin", default=FOREIGN_FRAMING)
    stream_options = kinds.add_parser("stream", help="any bytes, into <file>.json")
    stream_options.add_argument("file", help="bad_<cause>, forward_<what> or frames")
    stream_options.add_argument("name", help="what distinguishes this vector")
    stream_options.add_argument("bytes", type=bytes.fromhex, help="hex")
    stream_options.add_argument(
        "--origin", required=True, help="where the bytes and the expectation come from"
    )
    given = parser.parse_args(arguments)
    try:
        if given.kind == "message":
            file = VECTORS / f"{upper_snake(given.type).lower()}.json"
            message = parse_message(given.type, given.set)
            vector = message_vector(given.name, message, given.node, given.seq, given.origin)
        else:
            file = VECTORS / f"{given.file}.json"
            vector = stream_vector(given.name, given.bytes, given.origin)
    except (ValueError, SyntaxError, struct.error) as error:
        print(f"{given.kind} {given.name!r}: {error}", file=sys.stderr)
        return 2
    add_vector(file, vector)
    print(json.dumps(vector, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
