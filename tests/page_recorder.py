"""A recorder of two fake nodes with its live page, for tests and screenshots of the page."""

import contextlib
import os
import random
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np

from fakes.fake_node import FakeNode
from generators.fake_drive import VEHICLE_TOML, raw_rows, short_drive
from waiting import until

ROOT = Path(__file__).resolve().parents[1]
RATE_HZ = 104.0


def free_port():
    """Return a free port below the ephemeral range, whose ports another test may use a moment later."""
    for port in random.Random(os.getpid()).sample(range(15_000, 30_000), 100):
        with contextlib.suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port
    raise OSError("no port is free")


class RecorderWithPage:
    """Two fake nodes in real time, and a recorder with its page that can be stopped and started."""

    def __init__(self, folder, drive=None):
        """Drive: recorded by the nodes at 104 Hz; by default a short one, three times."""
        self.folder, self.logs = folder, 0
        (folder / "vehicle.toml").write_text(VEHICLE_TOML)
        self.port = free_port()
        repeats = 3 if drive is None else 1
        drive = drive or short_drive(5, RATE_HZ)
        self.nodes = [
            FakeNode(
                node_id=number,
                # Each sensor samples by its own oscillator; at another rate the wheels would drift apart.
                rate_hz=float(1.0 / np.mean(np.diff(drive.nodes[name].t))),
                rows=raw_rows(drive, name) * repeats,
                bias_q12=(900, -1400, 600),
                serial=f"FAKE000{number}".encode(),
            )
            for number, name in ((1, "left"), (2, "right"))
        ]
        self.process = None

    def start(self):
        self.logs += 1
        ports = [node.path for node in self.nodes]
        command = ["record", *ports, "-o", self.folder / f"ride{self.logs}.mcap"]
        command += ["--vehicle", self.folder / "vehicle.toml", f"--web=127.0.0.1:{self.port}"]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hubodo.cli", *map(str, command)],
            env={**os.environ, "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        until(self.is_listening)

    def is_listening(self):
        assert self.process.poll() is None, self.process.stderr.read()
        with contextlib.suppress(OSError):
            socket.create_connection(("127.0.0.1", self.port), timeout=1).close()
            return True

    def stop(self):
        self.process.terminate()
        return self.process.communicate(timeout=300)[1].decode()
