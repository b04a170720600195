"""A fake node on a pseudo terminal that sends hubowire frames, with unplugging, damage and resets on demand.

It answers requests as the firmware does: Ack or Nack for each, `Hello` for `GetHello`, two time stamps for
`TimeRequest`, Nack UNKNOWN_MESSAGE for messages that a host does not send.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import random
import select
import struct
import tempfile
import termios
import threading
import time
import tty
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from hubodo.ingest.live.virtual_computer import SentBytes, VirtualComputer
from hubowire import FINGERPRINT, Frame, FrameDecoder, Message, decode, encode, encode_frame
from hubowire.messages import (
    Ack,
    BiasInit,
    Filter,
    GetHello,
    Health,
    Hello,
    ImuBatch,
    Nack,
    Ping,
    Reason,
    Reboot,
    SetConfig,
    Start,
    Stop,
    TimeReply,
    TimeRequest,
)

PERIOD = 1 << 30
TURN_NS = 1_000_000


def sample(index: int) -> tuple[int, int, int, int, int, int]:
    """Return the raw sample of this number; all 65536 differ, so a test can identify each."""
    low = (index & 0x7FFF) - 0x4000
    return (low, -low, 300 + index % 7, (index * 7) % 2000 - 1000, 500, 2048)


@dataclass
class SentFrame:
    """A frame as written to the line."""

    wire: bytes
    intact: bool  # True if its own bytes are undamaged
    whole: bool  # True if the delimiter before it, which marks its start, is intact as well
    type_id: int
    plug: int  # number of times the device was plugged in before
    index: int = -1
    count: int = 0


@dataclass
class FakeNode:
    """A node that runs between `start` and `stop`; skew_ppm: rate error of its clock.

    computer: its virtual time is used from now on; None: real time, in a thread.
    """

    node_id: int = 1
    rate_hz: float = 208.0
    batch: int = 8
    damage: float = 0.0  # share of bytes damaged on the line
    skew_ppm: float = 0.0
    fingerprint: int = FINGERPRINT
    firmware: tuple[int, int, int] = (0, 1, 0)
    serial: bytes = b"FAKE0001"
    link: Path | None = None  # symlink to the present pseudo terminal; None: a new name at each plug
    seed: int = 1
    answers: bool = True
    hello_period: float = 5.0  # s, as the firmware
    spin_raw: int | None = None  # gz of every sample, instead of the numbered ones
    bias_q12: tuple[int, int, int] | None = None  # bias reported by its filter five times a second
    refuse: int | None = None  # the Reason for which settings and initialisations are refused
    battery_mv: int = 3700  # supply voltage of its next reports; 0: not measured
    charge: int = 255  # %, 255: unknown
    rows: Sequence[tuple[int, ...]] = ()  # samples of a drive, the last one repeated afterwards
    computer: VirtualComputer | None = None
    frames: list[SentFrame] = field(default_factory=list)
    requests: list[Message] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rng = random.Random(self.seed)
        self.path = ""
        self.boots = self.plugs = 0
        self.samples_created = 0
        self.boot_indices: list[int] = []  # samples created at each start
        self.dropped = 0
        self._stop = threading.Event()
        self._lock = threading.RLock()
        self._master = self._slave = -1
        self._folder = tempfile.TemporaryDirectory(prefix="hubodo-fake-")
        self._line_noise = Path()
        self._virtual_ns = 0 if self.computer is None else self.computer.now_ns()
        self._on_port: SentBytes = []
        self._boot()
        self.plug()
        self._thread = threading.Thread(target=self._run, daemon=True)

    # Actions for tests.

    def start(self) -> FakeNode:
        if self.computer is None:
            self._thread.start()
        else:
            self.computer.plug_in(self)
        return self

    def stop(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(5)
        self.unplug(drain=False)
        self._folder.cleanup()

    def __enter__(self) -> FakeNode:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    def plug(self) -> None:
        """Open a new pseudo terminal under another name than before.

        The name is a symlink, because another test could reuse the number of the terminal.
        """
        with self._lock:
            self.plugs += 1
            self._delimited = True
            self._pending_bytes = 0
            self._listened_to = self.computer is None
            self._master, self._slave = os.openpty()
            tty.setraw(self._slave)
            os.set_blocking(self._master, False)
            self._line_noise = self.link or Path(self._folder.name, f"tty{self.plugs}")
            self._line_noise.unlink(missing_ok=True)
            self._line_noise.symlink_to(os.ttyname(self._slave))
            self.path = str(self._line_noise)
            self._decoder = FrameDecoder()

    def unplug(self, *, drain: bool = True) -> None:
        """Remove the device after the host has read all pending bytes, so that a test can count them."""
        with self._lock:
            deadline = time.monotonic() + 2
            while drain and self._unread() and time.monotonic() < deadline:
                time.sleep(0.002)
            if self._master >= 0:
                os.close(self._slave)
                os.close(self._master)
            self._master = self._slave = -1
            self._line_noise.unlink(missing_ok=True)

    def reset(self) -> None:
        """Restart the node: clock, counters and sequence numbers from 0, a new boot id, a Hello."""
        with self._lock:
            self._boot()

    def lose(self, batches: int) -> None:
        """Drop this number of frames, as a full queue does."""
        with self._lock:
            for _ in range(batches):
                self._seq(ImuBatch)
                self._index += self.batch
                self.samples_created += self.batch
                self.dropped += 1

    # In virtual time; see `Device`.

    def advance_to(self, t_ns: int, received: int | None) -> None:
        self._listened_to = received is not None
        self._pending_bytes += received or 0
        while self._virtual_ns < t_ns:
            self._virtual_ns = min(self._virtual_ns + TURN_NS, t_ns)
            self._turn()
            while self._pending_bytes > 0:
                select.select([self._master], [], [])
                self._listen()

    def wait_for_writes(self) -> SentBytes:
        sent, self._on_port = self._on_port, []
        return sent

    # Internal methods.

    def _now(self) -> float:
        return time.monotonic() if self.computer is None else self._virtual_ns * 1e-9

    def _boot(self) -> None:
        self.boots += 1
        self._boot_id = self.rng.randrange(1, 65536)
        self._t0 = self._now()
        self._index = 0
        self._seqs: dict[int, int] = {}
        self.dropped = 0
        self._next_hello = 0.0
        self._next_health = 0.5
        self._next_filter = 0.1
        self._streaming = True
        self.boot_indices.append(self.samples_created)

    def _clock_us(self) -> int:
        return int((self._now() - self._t0) * 1e6 * (1 + self.skew_ppm * 1e-6))

    def _unread(self) -> int:
        if self._slave < 0:
            return 0
        return int(struct.unpack("I", fcntl.ioctl(self._slave, termios.FIONREAD, bytes(4)))[0])

    def _seq(self, message: type[Message]) -> int:
        seq = self._seqs.get(message.type_id, 0)
        self._seqs[message.type_id] = (seq + 1) & 0xFFFF
        return seq

    def hello(self) -> Hello:
        return Hello(
            fingerprint=self.fingerprint,
            firmware=self.firmware,
            serial=self.serial,
            boot_id=self._boot_id,
            board=0,
            reset_cause=1 if self.boots == 1 else 3,
            rate_mhz=int(self.rate_hz * 1000),
            gyro_range_dps=2000,
            accel_range_g=16,
            gyro_lsb_ndps=70_000_000,
            accel_lsb_ng=488_000,
            temperature_lsb_udegc=62_500,
            temperature_offset_udegc=25_000_000,
            mag_lsb_ft=0,
            batch=self.batch,
            filter_kind=0,
            stamp_bound_us=40,
            parts=((0x6B, 0x69, 1),),
        )

    def _put(self, message: Message, index: int = -1, count: int = 0) -> None:
        wire = encode_frame(Frame(message.type_id, self.node_id, self._seq(type(message)), encode(message)))
        on_line = bytearray(wire)
        for at in range(len(on_line) if self.damage else 0):
            if self.rng.random() < self.damage:
                on_line[at] ^= self.rng.randrange(1, 256)
        if self._master < 0:
            return
        try:
            written = os.write(self._master, on_line) if self._listened_to else len(on_line)
        except (BlockingIOError, OSError):
            self.dropped += 1
            return
        if self.computer is not None and self._listened_to:
            self._on_port.append((self._virtual_ns, written))
        intact = bytes(on_line) == wire and written == len(wire)
        whole = intact and self._delimited
        self._delimited = on_line[written - 1] == 0
        self.frames.append(SentFrame(wire, intact, whole, message.type_id, self.plugs, index, count))

    def _run(self) -> None:
        while not self._stop.is_set():
            with self._lock:
                self._turn()
                self._listen()
                fd = self._master
            if fd >= 0:
                with contextlib.suppress(OSError, ValueError):  # unplugged meanwhile
                    select.select([fd], [], [], 0.002)
            time.sleep(0.002)

    def _turn(self) -> None:
        if self._clock_us() * 1e-6 >= self._next_hello:
            self._next_hello = self._clock_us() * 1e-6 + self.hello_period
            self._put(self.hello())
        period = 1 / self.rate_hz
        now = self._clock_us() * 1e-6
        while self._streaming and (self._index + self.batch) * period <= now:
            numbers = range(self._index, self._index + self.batch)
            rows = tuple(sample(self.samples_created + k) for k in range(self.batch))
            if self.spin_raw is not None:
                rows = tuple((0, 0, self.spin_raw, 0, 0, 2048) for _ in numbers)
            if self.rows:
                at = [min(self.samples_created + k, len(self.rows) - 1) for k in range(self.batch)]
                rows = tuple(self.rows[k] for k in at)
            t_us = int(self._index * period * 1e6) % PERIOD
            batch = ImuBatch(t_us, round(period * 1e9), self._index & 0xFFFF, 16, 0, rows)
            self._put(batch, self.samples_created, self.batch)
            self._index += self.batch
            self.samples_created += self.batch
        if self.bias_q12 is not None and now >= self._next_filter:
            self._next_filter = now + 0.2
            t_us = int(self._index * period * 1e6) % PERIOD
            self._put(Filter(t_us, 2, 0, 2000, (256, 0, 0), self.bias_q12, (256, 0, 1024), (41, 0, 82)))
        if now >= self._next_health:
            self._next_health = now + 0.5
            t_us = self._clock_us() % PERIOD
            dropped = min(self.dropped, 65535)
            self._put(
                Health(t_us, self.battery_mv, 0, 0, 0, 0, 0, dropped, 0, 1, 900, 1, 50_000, 40, self.charge)
            )

    def _listen(self) -> None:
        if self._master < 0:
            return
        try:
            data = os.read(self._master, 4096)
        except (BlockingIOError, OSError):
            return
        self._pending_bytes -= len(data)
        for frame in self._decoder.feed(data):
            message = decode(frame.type_id, frame.payload)
            if message is not None:
                self.requests.append(message)
            if self.answers:
                self._answer(frame, message)

    def _answer(self, frame: Frame, message: Message | None) -> None:
        match message:
            case GetHello():
                self._put(self.hello())
            case TimeRequest():
                now = self._clock_us() % PERIOD
                self._put(TimeReply(message.token, now, self._clock_us() % PERIOD))
            case SetConfig() | BiasInit() if self.refuse is not None:
                self._put(Nack(frame.type_id, frame.seq, self.refuse, 7))
            case Ping() | SetConfig() | BiasInit():
                self._put(Ack(frame.type_id, frame.seq))
            case Start() | Stop():
                self._streaming = isinstance(message, Start)
                self._put(Ack(frame.type_id, frame.seq))
            case Reboot():
                self._put(Ack(frame.type_id, frame.seq))
                self._boot()
            case _:
                self._put(Nack(frame.type_id, frame.seq, Reason.UNKNOWN_MESSAGE, frame.type_id))
