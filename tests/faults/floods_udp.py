"""Floods of a UDP port on real sockets, beside four nodes at 416 Hz on a real `hubodo record`: samples lost.

`python tests/faults/floods_udp.py --seconds 60` prints each; `make faults` does.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

TESTS = Path(__file__).parents[1]
sys.path.insert(0, str(TESTS))

from fakes.udp_nodes import UdpNodes  # noqa: E402 the folder of the tests is to be found first
from faults.line import HELLO, Node  # noqa: E402
from hubodo.ingest.link.keys import KeyRing  # noqa: E402
from hubodo.log.recording_reader import open_log, read_recording  # noqa: E402
from waiting import until  # noqa: E402

_SERIALS = [f"e6614103000000{k:02x}" for k in range(1, 5)]
_NODES = len(_SERIALS)
_JOIN_S = 10.0


@dataclass(frozen=True)
class FloodResult:
    """Result of a flood.

    sent, recorded: samples of four nodes; datagrams: datagrams of the flood; memory_mb: growth of the memory.
    joined_s: time from the restart of a node during the flood until it was recorded again; None if it never
    was. events: number of events in the log by kind.
    """

    sent: int
    recorded: int
    datagrams: int
    memory_mb: float
    joined_s: float | None
    log_mb: float
    events: dict[str, int]

    @property
    def lost(self) -> int:
        """Samples sent but not recorded."""
        return self.sent - self.recorded


def flood_of_nodes(folder: Path, count: int = 300, per_second: float = 300.0) -> FloodResult:
    """Yield datagrams of nodes without keys, each with its own serial and address: a Hello and a frame."""
    hellos = [_stranger(k) for k in range(count)]

    def flood() -> Iterator[tuple[str, bytes]]:
        for k, node in enumerate(hellos):
            yield f"127.1.{k >> 8}.{1 + k % 255}", node.hello_frame() + node.batch()

    return _run(folder, flood(), per_second, with_keys=False)


def flood_of_addresses(folder: Path, count: int = 12_000, per_second: float = 1000.0) -> FloodResult:
    """Yield frames without a Hello, five at a time, each time from a new address."""
    frame = _stranger(1).batch() * 5

    def flood() -> Iterator[tuple[str, bytes]]:
        for k in range(count):
            yield f"127.{2 + (k >> 16)}.{k >> 8 & 255}.{k & 255 or 1}", frame

    return _run(folder, flood(), per_second, with_keys=False)


def flood_of_openings(folder: Path, seconds: float, per_second: float = 300.0) -> FloodResult:
    """Yield forged openings, proofs and data, and replayed datagrams of nodes with keys."""
    rng = random.Random(1)

    def flood(recorded: list[bytes]) -> Iterator[tuple[str, bytes]]:
        for k in range(int(seconds * per_second)):
            forged = (b"\xfe\x21" + rng.randbytes(16), b"\xfe\x23" + rng.randbytes(32), rng.choice(recorded))
            yield "127.0.0.1", forged[k % 3]

    return _run(folder, flood, per_second, with_keys=True)


def _stranger(number: int) -> Node:
    return Node(replace(HELLO, serial=number.to_bytes(8, "big")))


Flood = Iterator[tuple[str, bytes]]


def _run(
    folder: Path, flood: Flood | Callable[[list[bytes]], Flood], per_second: float, *, with_keys: bool
) -> FloodResult:
    """Record with a flood in the middle and a restart of a node during the flood."""
    log, to = folder / "drive.mcap", ("127.0.0.1", _free_port())
    ring = KeyRing(folder / "keys.toml", create=True)
    keys = {
        bytes.fromhex(serial): ring.get_or_create_key(serial) if with_keys else None for serial in _SERIALS
    }
    words = ["--key-file", str(ring.path)] if with_keys else []
    with _recorder(to[1], log, words) as process:
        with UdpNodes(to, keys) as bank:
            _wait_for(bank)
            before = _memory(process.pid)
            until(lambda: min(node.samples_sent for node in bank.nodes) > 200)
            datagrams = _send_flood(
                flood
                if isinstance(flood, Iterator)
                else flood([d for node in bank.nodes for d in node.sent]),
                to,
                per_second,
                lambda: bank.restart(bank.nodes[-1]),
            )
            joined_s = _wait_for(bank)
            more = bank.nodes[-1].samples_sent + 100
            until(lambda: bank.nodes[-1].samples_sent > more)
        time.sleep(0.3)  # data in transit
        after = _memory(process.pid)
    recorded, events = _in_log(log)
    sent = sum(node.samples_sent for node in bank.nodes)
    return FloodResult(
        sent, recorded, datagrams, (after - before) / 1e6, joined_s, log.stat().st_size / 1e6, events
    )


def _wait_for(bank: UdpNodes) -> float | None:
    """Return the seconds until the restarted node was recorded again; None after ten."""
    end = time.monotonic() + _JOIN_S
    while any(node.joined_s is None for node in bank.nodes) and time.monotonic() < end:
        time.sleep(0.01)
    return bank.nodes[-1].joined_s


def _send_flood(
    flood: Flood, to: tuple[str, int], per_second: float, in_the_middle: Callable[[], None]
) -> int:
    """Send a flood at a constant rate; return the number of datagrams. 127.0.0.1 uses one socket."""
    datagrams = list(flood)
    begun = time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as single:
        single.bind(("127.0.0.1", 0))
        for k, (address, data) in enumerate(datagrams):
            if k == len(datagrams) // 2:
                in_the_middle()
            time.sleep(max(begun + k / per_second - time.monotonic(), 0.0))
            if address == "127.0.0.1":
                single.sendto(data, to)
                continue
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
                own.bind((address, 0))
                own.sendto(data, to)
    return len(datagrams)


@contextmanager
def _recorder(port: int, log: Path, words: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-m", "hubodo", "record", f"udp://127.0.0.1:{port}", "-o", str(log), *words]
    with subprocess.Popen(
        [*command, "--quiet"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as process:
        try:
            until(lambda: log.exists() or process.poll() is not None)
            yield process
            process.send_signal(signal.SIGTERM)
            _, line = process.communicate(timeout=60)
            assert process.returncode == 0, line.decode()
        finally:
            process.kill()


def _in_log(log: Path) -> tuple[int, dict[str, int]]:
    """Return the samples of the four nodes and the number of events by kind."""
    counts, recorded, kinds = read_recording(log), 0, dict[str, int]()
    with open_log(log) as records:
        for name, table in counts.nodes.items():
            if records.metadata_records[f"node.{name}"]["serial"] in _SERIALS:
                recorded += len(table.t)
        for message in records.messages():
            if message.topic == "/hubodo/events":
                kind = str(
                    json.loads(bytes(message.data)[bytes(message.data).index(b"{") :].rstrip(b"\0"))["kind"]
                )
                kinds[kind] = kinds.get(kind, 0) + 1
    return recorded, kinds


def _memory(pid: int) -> int:
    """Return the resident memory, bytes."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="of the flood beside nodes with keys")
    args = parser.parse_args()
    floods: dict[str, Callable[[Path], FloodResult]] = {
        "300 nodes": flood_of_nodes,
        "12,000 addresses, 1,000 a second": flood_of_addresses,
        "300 openings, proofs and old datagrams a second, nodes with keys": lambda folder: flood_of_openings(
            folder, args.seconds
        ),
    }
    lost = 0
    for name, flood in floods.items():
        with tempfile.TemporaryDirectory() as folder:
            result = flood(Path(folder))
        lost += result.lost
        rejoined = "never" if result.joined_s is None else f"{result.joined_s:.2f} s"
        print(
            f"{name}: {result.datagrams} datagrams; {result.lost} of {result.sent} samples lost, "
            f"memory {result.memory_mb:+.1f} MB, a restarted node is in after {rejoined}; {result.events}",
            flush=True,
        )
    return int(lost != 0)


if __name__ == "__main__":
    sys.exit(main())
