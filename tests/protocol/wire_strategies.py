"""Hypothesis strategies for messages and frames, and ways to damage a stream."""

from itertools import pairwise

import numpy as np
from hypothesis import strategies as st

from hubowire import MAX_PAYLOAD, MESSAGES, Frame, Message, encode, encode_frame
from hubowire.codec import payload_layout
from hubowire.messages import wire_fields

_BITS = {"b": 8, "B": 8, "h": 16, "H": 16, "i": 32, "I": 32}


def _number(letter: str) -> st.SearchStrategy[int]:
    bits = _BITS[letter]
    return (
        st.integers(0, 2**bits - 1)
        if letter.isupper()
        else st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    )


def message(kind: type[Message]) -> st.SearchStrategy[Message]:
    """Return a strategy of all messages of a class, over the whole range of each field."""
    values = {}
    for row in wire_fields(kind):
        code = row.type.removesuffix("[]")
        count, letter = int(code[:-1] or 1), code[-1]
        if row.is_table:
            shape = payload_layout(kind)
            most = (MAX_PAYLOAD - shape.fixed.size) // shape.rows.size
            rows = st.tuples(*[_number(letter)] * count)
            values[row.name] = st.lists(rows, max_size=most).map(tuple)
        elif letter == "s":
            values[row.name] = st.binary(min_size=count, max_size=count)
        else:
            values[row.name] = st.tuples(*[_number(letter)] * count) if count > 1 else _number(letter)
    return st.builds(kind, **values)


messages = st.one_of([message(kind) for kind in MESSAGES])
frames = st.builds(
    Frame, st.integers(0, 255), st.integers(0, 255), st.integers(0, 65535), st.binary(max_size=MAX_PAYLOAD)
)


@st.composite
def message_frames(draw: st.DrawFn) -> Frame:
    """Draw a frame with a message of the table."""
    body = draw(messages)
    return Frame(body.type_id, draw(st.integers(0, 3)), draw(st.integers(0, 65535)), encode(body))


@st.composite
def portions(draw: st.DrawFn, stream: bytes) -> list[bytes]:
    """Draw the stream in random portions, including empty ones."""
    cuts = sorted(draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    edges = [0, *cuts, len(stream)]
    return [stream[a:b] for a, b in pairwise(edges)]


def dirty(stream: bytes, rng: np.random.Generator, share: float = 0.01, *, splices: bool = True) -> bytes:
    """Return the stream with `share` of its bytes replaced, and 1 % as many cuts, splices and insertions.

    splices: True to repeat pieces of the stream elsewhere, also before their original position.
    """
    data = np.frombuffer(stream, np.uint8).copy()
    hit = rng.random(len(data)) < share
    data[hit] = rng.integers(0, 256, np.count_nonzero(hit))
    out = data.tobytes()
    for _ in range(rng.poisson(len(out) * share / 100)):
        at, length = rng.integers(0, len(out) + 1), rng.integers(0, 300)
        from_where = rng.integers(0, len(out) + 1)
        match rng.integers(0, 5):
            case 0:
                out = out[:at] + out[at + length :]
            case 1 if splices:
                out = out[:at] + out[from_where : from_where + length] + out[at:]
            case 2:
                out = out[:at] + bytes(length % 5) + out[at:]
            case 3:
                out = out[:at] + b"\0\x03\x07\x07\0" + out[at:]
            case _:
                out = out[:at] + rng.integers(1, 256, length, dtype=np.uint8).tobytes() + out[at:]
    return out


def drive(rng: np.random.Generator, count: int) -> bytes:
    """Return a busy link: batches of 1 to 19 samples of two nodes, and occasionally the other messages."""
    kinds = rng.choice([1, 2, 3, 4, 5, 6, 8, 99], count, p=[0.01, 0.7, 0.1, 0.1, 0.03, 0.02, 0.03, 0.01])
    sizes = {
        1: [49, 55],
        2: [14 + 12 * n for n in (1, 8, 16, 19)],
        3: [10],
        4: [47],
        5: [30],
        6: [3],
        8: [16],
        99: [0, 7],
    }
    out = []
    for seq, kind in enumerate(kinds):
        size = int(rng.choice(sizes[int(kind)]))
        body = bytearray(rng.integers(0, 256, size, dtype=np.uint8) * (rng.random(size) < 0.8))
        if kind == 2:
            # Occasionally the count does not match the payload.
            body[13] = (size - 14) // 12 + int(rng.random() < 0.02)
        out.append(encode_frame(Frame(int(kind), 1 + seq % 2, seq % 65536, bytes(body))))
    return b"".join(out)
