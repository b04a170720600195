"""A recording of two emulated nodes in real time that lasts until its output has done what a test needs.

A fixed duration would depend on the load of the computer.
"""

import json
import subprocess
import sys
import threading
from contextlib import ExitStack
from pathlib import Path

from fakes.fake_node import FakeNode
from generators.fake_drive import VEHICLE_TOML, raw_rows, short_drive
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.vehicle import load_vehicle

FAKES = Path(__file__).resolve().parent / "fakes"
MAX_SECONDS = 60.0
MIN_POSES, MIN_SNAPSHOTS = 300, 3


class OtherProcess:
    """A program of tests/fakes that prints `ready`, `received`, and its result after a line on its input."""

    def __init__(self, name, *words):
        """Start it; return once it listens."""
        command = [sys.executable, str(FAKES / name), *map(str, words)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout.readline() == "ready\n"
        self._received = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._text = ""

    def _read(self):
        for line in self.process.stdout:
            if line == "received\n":
                self._received.set()
            else:
                self._text += line

    def has_received(self):
        """Return True once it has received enough."""
        return self._received.is_set()

    def result(self):
        """End it and return its JSON result."""
        self.process.stdin.write("\n")
        self.process.stdin.close()
        self._reader.join(30)
        self.process.wait(10)
        return json.loads(self._text)


def record_ride(folder, ros2, is_received=lambda: True):
    """Record into ride.mcap until there are `MIN_POSES` poses and `is_received()`; return the result as JSON.

    ros2: completed settings of the ROS 2 node. is_received: asked once per second.
    """
    drive, done, snapshots = short_drive(5), threading.Event(), []
    (folder / "vehicle.toml").write_text(VEHICLE_TOML)

    def watch(snapshot):
        snapshots.append(snapshot)
        odometry = snapshot.odometry
        enough = odometry is not None and odometry.poses >= MIN_POSES and len(snapshots) >= MIN_SNAPSHOTS
        if enough and is_received():
            done.set()

    with ExitStack() as stack:
        nodes = {
            name: stack.enter_context(FakeNode(node_id=number, rows=raw_rows(drive, name)))
            for number, name in ((1, "left"), (2, "right"))
        }
        ports = tuple(f"{name}={node.path}" for name, node in nodes.items())
        config = RecordConfig(ports=ports, duration=MAX_SECONDS, quiet=True)
        vehicle = load_vehicle(folder / "vehicle.toml")
        result = record(
            config, folder / "ride.mcap", vehicle=vehicle, stop=done, watch={"test": watch}, ros2=ros2
        )
    assert done.is_set(), f"no {MIN_POSES} poses within {MAX_SECONDS:g} s"
    return result.as_json()
