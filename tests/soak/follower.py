"""A client of the live page and of the metrics beside a long recording.

    python tests/soak/follower.py PAGE_PORT METRICS_PORT

Ends when its standard input is closed, and prints how many frames and how many readings there were.
"""

import sys
import threading
import time
import urllib.error
import urllib.request

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect


class Follower:
    """Counters of a client; frames: messages of the live page; readings: of the metrics."""

    def __init__(self, page: int, metrics: int) -> None:
        self.frames = self.readings = 0
        self._page, self._metrics = page, metrics

    def follow(self) -> None:
        """Read the live page until it ends; repeat a handshake that a busy computer did not answer."""
        while True:
            try:
                with connect(f"ws://127.0.0.1:{self._page}/live", max_size=None) as live:
                    for _ in live:
                        self.frames += 1
                return
            except TimeoutError:
                continue
            except ConnectionClosed:
                return

    def read_metrics(self) -> None:
        """Read /metrics and /healthz each second of the wall clock, as soon as they are served."""
        while True:
            try:
                for path in ("metrics", "healthz"):
                    address = f"http://127.0.0.1:{self._metrics}/{path}"
                    with urllib.request.urlopen(address, timeout=60) as answer:
                        answer.read()
                self.readings += 1
            except urllib.error.URLError:
                pass  # not yet available, or closed already
            time.sleep(1.0)


if __name__ == "__main__":
    follower = Follower(*map(int, sys.argv[1:]))
    for task in (follower.follow, follower.read_metrics):
        threading.Thread(target=task, daemon=True).start()
    sys.stdin.read()
    print(follower.frames, follower.readings)
