"""Many nodes in one process, each on a pseudo terminal, with frames prepared once for all of them.

`python tests/load/nodes.py 64 416 8` prints the ports, starts at the first line of input and ends with its
input; the last line gives the number of batches, and of batches for which a line had no room.
"""

from __future__ import annotations

import json
import os
import select
import sys
import time
import tty
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from hubowire import FINGERPRINT, Frame, FrameDecoder, Message, decode, encode, encode_frame
from hubowire.messages import GetHello, Hello, ImuBatch, TimeReply, TimeRequest

_TURN_S = 0.002


class ManyNodes:
    """`count` nodes at rate_hz; the phases of their batches are spread over a period."""

    def __init__(self, count: int, rate_hz: float, batch: int) -> None:
        self.batch, self.period_ns = batch, round(1e9 / rate_hz)
        self.hello = Hello(
            FINGERPRINT, (1, 2, 3), b"load0001", 77, 1, 1, round(1000 * rate_hz), 2000, 16,
            70_000_000, 488_000, 62_500, 25_000_000, 14_614_000, batch, 0, 40, ((0x6B, 0x69, 1),),
        )  # fmt: skip
        self.ports = [os.openpty() for _ in range(count)]
        for master, slave in self.ports:
            tty.setraw(slave)
            os.set_blocking(master, False)
        self.paths = [os.ttyname(slave) for _, slave in self.ports]
        self.at = {master: place for place, (master, _) in enumerate(self.ports)}
        self.received = [FrameDecoder() for _ in self.ports]
        self.answers = [0] * count
        self.batches = self.refused = 0
        self.start_ns = time.monotonic_ns()

    def now_us(self) -> int:
        return (time.monotonic_ns() - self.start_ns) // 1000

    def run(self) -> None:
        """Run until the input ends. Frame n of a node is due after its last sample."""
        listening = [master for master, _ in self.ports]
        frame_ns = self.batch * self.period_ns
        due = [(frame_ns * place // len(self.ports), 0) for place in range(len(self.ports))]
        frames: dict[int, bytes] = {}
        self.start_ns = time.monotonic_ns() - 1_000_000
        while True:
            ready = select.select([sys.stdin, *listening], [], [], _TURN_S)[0]
            if sys.stdin in ready:
                return
            for master in ready:
                self.answer(self.at[master])
            now = time.monotonic_ns() - self.start_ns
            for place, (offset, number) in enumerate(due):
                while offset + (number + 1) * frame_ns <= now:
                    self.batches += 1
                    self.refused += not self.put(place, self.frame(number, place, frames))
                    number += 1
                due[place] = (offset, number)
            if len(frames) > 64:
                for old in sorted(frames)[:-32]:
                    del frames[old]

    def frame(self, number: int, place: int, frames: dict[int, bytes]) -> bytes:
        """Return frame n, preceded by a Hello every five seconds."""
        if number not in frames:
            t_us = number * self.batch * self.period_ns // 1000 % (1 << 30)
            rows = tuple((100 + k, -5, 300, 10, k, 2048) for k in range(self.batch))
            index = number * self.batch & 0xFFFF
            body = encode(ImuBatch(t_us, self.period_ns, index, 160, 0, rows))
            frames[number] = encode_frame(Frame(ImuBatch.type_id, 1, number & 0xFFFF, body))
        hello = number % round(5e9 / (self.batch * self.period_ns)) == 0
        return (self.wire(place, self.hello) if hello else b"") + frames[number]

    def wire(self, place: int, message: Message) -> bytes:
        self.answers[place] += 1
        return encode_frame(Frame(message.type_id, 1, self.answers[place] & 0xFFFF, encode(message)))

    def put(self, place: int, data: bytes) -> bool:
        """Write to a line; return False if it had no room, in which case the data is lost."""
        try:
            return os.write(self.ports[place][0], data) == len(data)
        except BlockingIOError:
            return False

    def answer(self, place: int) -> None:
        master = self.ports[place][0]
        try:
            data = os.read(master, 4096)
        except OSError:
            return
        received = self.now_us()
        for frame in self.received[place].feed(data):
            asked = decode(frame.type_id, frame.payload)
            if isinstance(asked, GetHello):
                self.put(place, self.wire(place, self.hello))
            elif isinstance(asked, TimeRequest):
                offset = self.batch * self.period_ns // 1000 * place // len(self.ports)
                times = [(t - offset) % (1 << 30) for t in (received, self.now_us())]
                self.put(place, self.wire(place, TimeReply(asked.token, *times)))


def main() -> None:
    nodes = ManyNodes(int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]))
    print(json.dumps(nodes.paths), flush=True)
    sys.stdin.readline()
    nodes.run()
    print(json.dumps({"batches": nodes.batches, "refused": nodes.refused}), flush=True)


if __name__ == "__main__":
    main()
