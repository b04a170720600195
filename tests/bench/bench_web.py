"""Processor share of the live page of a recorder with four nodes at 208 Hz while a client reads it.

    python tests/bench/bench_web.py [--seconds 30]

Processor time of the server's thread, and of what is done for the page within the recording's own.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fakes.fake_node import FakeNode
from fakes.recorder_thread import RecorderThread
from generators.fake_drive import VEHICLE_TOML, raw_rows, short_drive
from hubodo.vehicle import load_vehicle
from hubodo.web.address import Address
from hubodo.web.app import make_app
from hubodo.web.config import Site
from hubodo.web.hub import FrameHub
from hubodo.web.library import RecordingLibrary
from hubodo.web.live_page import LivePage
from hubodo.web.server import serve_in_thread

NODES, RATE_HZ, LIMIT = 4, 208.0, 0.05
CLIENT = """
import sys
from websockets.sync.client import connect
with connect(f"ws://127.0.0.1:{sys.argv[1]}/live", max_size=None) as live:
    print(len(live.recv()), flush=True)
    for _ in live:
        pass
"""


class TimedPage(LivePage):
    """A wrapper that counts the processor time used in the recording thread."""

    spent = 0.0

    def poll(self, recorder, now_ns):
        start = time.thread_time()
        super().poll(recorder, now_ns)
        self.spent += time.thread_time() - start


class TimedEar:
    """A listener that counts the processor time of the records it receives."""

    def __init__(self, hear):
        self.hear, self.spent = hear, 0.0

    def __call__(self, *arguments):
        start = time.thread_time()
        self.hear(*arguments)
        self.spent += time.thread_time() - start


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=30.0)
    seconds = parser.parse_args().seconds
    drive, hub, site = short_drive(5), FrameHub({}), Site(Address("127.0.0.1", 0))
    page = TimedPage(hub.put)
    ear = page._observer.observe = TimedEar(page._observer.observe)
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        (folder / "vehicle.toml").write_text(VEHICLE_TOML)
        rows = {number: raw_rows(drive, node) for number, node in ((1, "left"), (2, "right"))}
        nodes = [
            stack.enter_context(FakeNode(node_id=k + 1, rate_hz=RATE_HZ, rows=rows.get(k + 1, ())))
            for k in range(NODES)
        ]
        port = stack.enter_context(serve_in_thread(make_app(site, RecordingLibrary(folder), hub), site))
        ports = [node.path for node in nodes]
        vehicle = load_vehicle(folder / "vehicle.toml")
        recorder = RecorderThread(folder / "x.mcap", *ports, vehicle=vehicle, audience=page)
        stack.enter_context(recorder)
        client = subprocess.Popen(
            [sys.executable, "-c", CLIENT, str(port)],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        client.stdout.readline()
        server = next(thread for thread in threading.enumerate() if thread.name == "hubodo web")
        clock = time.pthread_getcpuclockid(server.ident)
        before = (time.clock_gettime(clock), page.spent + ear.spent)
        time.sleep(seconds)
        after = (time.clock_gettime(clock), page.spent + ear.spent)
        client.kill()
        client.wait()
    served, recording = ((b - a) / seconds for a, b in zip(before, after, strict=True))
    print(
        f"the live page of {NODES} nodes at {RATE_HZ:.0f} Hz, one client, {seconds:.0f} s: "
        f"{100 * (served + recording):.2f} % of a core ({100 * recording:.2f} % in the recording, "
        f"{100 * served:.2f} % in the server)"
    )
    return 0 if served + recording < LIMIT else 1


if __name__ == "__main__":
    sys.exit(main())
