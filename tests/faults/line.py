"""A node's line without a port: the node's bytes, a recorder that receives them, and simulated time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hubodo.ingest.link.link import Chunk, LinkLost, LinkUp
from hubodo.ingest.live.recorder import Recorder
from hubodo.log.records import EventRecord, ImuBlock, LogRecord, RawFrame
from hubodo.recording import Event
from hubodo.units import NS_PER_S
from hubowire import FINGERPRINT, Frame, Message, encode, encode_frame
from hubowire.messages import Hello, ImuBatch

T0 = 1_700_000_000 * NS_PER_S
PERIOD_NS, BATCH = 4_807_692, 8
HELLO = Hello(
    FINGERPRINT, (1, 2, 3), b"serial01", 77, 1, 1, 208_000, 2000, 16,
    70_000_000, 488_000, 62_500, 25_000_000, 14_614_000, 8, 0, 40, ((0x6B, 0x69, 1),),
)  # fmt: skip


@dataclass
class Node:
    """A node that numbers frames and samples; gx and ay of a sample are its number."""

    hello: Hello = HELLO
    node_id: int = 1
    index: int = 0
    clock_us: int = 0  # offset of its clock from the sample times
    seqs: dict[int, int] = field(default_factory=dict)

    def frame(self, message: Message) -> bytes:
        seq = self.seqs.get(message.type_id, 0)
        self.seqs[message.type_id] = (seq + 1) & 0xFFFF
        return encode_frame(Frame(message.type_id, self.node_id, seq, encode(message)))

    def hello_frame(self) -> bytes:
        return self.frame(self.hello)

    def batch(self) -> bytes:
        numbers = range(self.index, self.index + BATCH)
        rows = tuple((k % 1000, 0, -5, 0, k % 1000, 2049) for k in numbers)
        t_us = (self.clock_us + self.index * PERIOD_NS // 1000) % (1 << 30)
        frame_bytes = self.frame(ImuBatch(t_us, PERIOD_NS, self.index & 0xFFFF, 160, 0, rows))
        self.index += BATCH
        return frame_bytes

    def restart(self, boot_id: int) -> None:
        self.hello = replace(self.hello, boot_id=boot_id)
        self.index, self.seqs = 0, {}


class StoredRecords:
    """A sink that stores records by kind."""

    def __init__(self) -> None:
        self.records: list[LogRecord] = []
        self.events: list[Event] = []
        self.raws: list[tuple[str, bytes]] = []
        self.rows: dict[str, list[np.ndarray[Any, Any]]] = {}

    def write_record(self, record: LogRecord) -> None:
        match record:
            case RawFrame():
                self.raws.append((record.link, record.frame))
            case EventRecord():
                self.events.append(record.event)
            case ImuBlock():
                self.rows.setdefault(record.node, []).append(record.gyro)
            case _:
                self.records.append(record)

    def numbers(self, node: str = "left") -> list[int]:
        """Return the numbers of the samples received, modulo 1000, in order."""
        step = HELLO.gyro_lsb_ndps * 1e-9 * np.pi / 180
        rows = np.concatenate(self.rows.get(node, [np.empty((0, 3))]))
        return [round(x / step) for x in rows[:, 0]]

    def kinds(self) -> list[str]:
        return [event.kind for event in self.events]

    def causes(self) -> list[str]:
        return [str(event.data["cause"]) for event in self.events if event.kind == "gap"]


class Line:
    """A recorder of one or more links in simulated time."""

    def __init__(self, *labels: str, datagrams: bool = False) -> None:
        self.sink, self.now, self.datagrams = StoredRecords(), T0, datagrams
        names = dict.fromkeys(labels or ("usb0",))
        self.recorder = Recorder(names, self.sink, lambda *_: True, lambda: self.now)
        for label in names:
            self.plug(label)

    def plug(self, label: str = "usb0") -> None:
        self.recorder.handle(LinkUp(label, self.now, f"/dev/{label}", self.datagrams))

    def unplug(self, label: str = "usb0") -> None:
        self.recorder.handle(LinkLost(label, self.now, "unplugged"))

    def receive(
        self,
        data: bytes,
        label: str = "usb0",
        seconds: float = BATCH * PERIOD_NS / NS_PER_S,
        sender: str = "",
    ) -> None:
        """Receive bytes, then advance the time by `seconds`."""
        if data:
            self.recorder.handle(Chunk(label, self.now, data, sender))
        self.now += round(seconds * NS_PER_S)
        self.recorder.tick(self.now)

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.1)):
            self.receive(b"", seconds=0.1)

    def close(self) -> StoredRecords:
        self.recorder.close()
        return self.sink

    def link(self, label: str = "usb0") -> Any:
        return self.recorder.links[label]
