"""`make load`: four nodes are recorded while 1,500 connections to the page or metrics are idle; not a test.

The recorder starts with the usual soft limit of 1,024 descriptors. Printed for each port: samples sent and
recorded, the most descriptors that the recorder held, and how long a proper request took meanwhile. `--slow`
sends a request byte by byte on each connection.
"""

from __future__ import annotations

import argparse
import json
import resource
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
NODES, RATE_HZ, BATCH = 4, 416, 8
USUAL_LIMIT = 1024
PATHS = {"--web": "/api/recordings", "--metrics": "/metrics"}
_HEAD = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: "


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--connections", type=int, default=1500)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument(
        "--slow", action="store_true", help="a byte of a request on each, four times a second"
    )
    args = parser.parse_args()
    results = []
    for option in PATHS:
        results.append(run(option, args.connections, args.seconds, slow=args.slow))
        print(results[-1], flush=True)
    return int(not all(result.is_complete for result in results))


@dataclass(frozen=True)
class IdleResult:
    """Samples sent and recorded, and requests of a regular client meanwhile."""

    option: str
    connections: str
    sent: int
    recorded: int
    code: int
    descriptors: int
    requests: int
    answered: int
    slowest_s: float

    @property
    def is_complete(self) -> bool:
        """Return True if nothing was lost and every request answered."""
        return self.recorded == self.sent and self.code == 0 and self.answered == self.requests

    def __str__(self) -> str:
        return (
            f"{self.option}, {self.connections} connections: {self.recorded} of {self.sent} samples "
            f"recorded, exit code {self.code}, at most {self.descriptors} descriptors; {self.answered} of "
            f"{self.requests} requests answered, the slowest after {1e3 * self.slowest_s:.0f} ms"
        )


def run(option: str, connections: int, seconds: float, *, slow: bool) -> IdleResult:
    """Record once with the server of `option`, beside idle or slow connections."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, connections + 500), hard))
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    words = [sys.executable, str(FOLDER / "nodes.py"), str(NODES), str(RATE_HZ), str(BATCH)]
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as nodes,
        ExitStack() as stack,
    ):
        assert nodes.stdin is not None and nodes.stdout is not None
        paths = json.loads(nodes.stdout.readline())
        names = [f"n{place}" for place in range(len(paths))]
        ports = [f"{name}={path}" for name, path in zip(names, paths, strict=True)]
        command = [
            sys.executable,
            "-m",
            "hubodo.cli",
            "record",
            *ports,
            "-o",
            f"{folder}/idle.mcap",
            "--json",
        ]
        command += ["--quiet", option, f"127.0.0.1:{port}", "--duration", str(seconds + 6)]
        recorder = subprocess.Popen(
            ["sh", "-c", f'ulimit -Sn {USUAL_LIMIT}; exec "$@"', "sh", *command],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        url = f"http://127.0.0.1:{port}{PATHS[option]}"
        while request_time(url) is None and recorder.poll() is None:
            time.sleep(0.1)
        print("go", file=nodes.stdin, flush=True)
        idle = []
        for _ in range(connections):
            with suppress(OSError):
                idle.append(stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=5)))
        held, times = 0, []
        end, text = time.monotonic() + seconds, _HEAD
        while time.monotonic() < end and recorder.poll() is None:
            for connection in idle if slow else ():
                with suppress(OSError):
                    connection.sendall(text)
            text = b"a"
            with suppress(OSError):
                held = max(held, len(list(Path(f"/proc/{recorder.pid}/fd").iterdir())))
            times.append(request_time(url))
            time.sleep(0.25)
        with suppress(OSError):
            nodes.stdin.close()
        sent = json.loads(nodes.stdout.readline())["batches"] * BATCH
        # At once, because another program could reuse the name of a node's terminal.
        recorder.terminate()
        out, _ = recorder.communicate(timeout=60)
    result: dict[str, Any] = json.loads(out) if out.strip() else {"nodes": {}}
    recorded = sum(node["samples"] for name, node in result["nodes"].items() if name in names)
    answered = [durations for durations in times if durations is not None]
    return IdleResult(
        option,
        f"{len(idle)} {'slow' if slow else 'idle'}",
        sent,
        recorded,
        recorder.returncode,
        held,
        len(times),
        len(answered),
        max(answered, default=0.0),
    )


def request_time(url: str) -> float | None:
    """Return how long a request takes, s; None where it is not answered with 200."""
    start = time.monotonic()
    try:
        with urllib.request.urlopen(url, timeout=10) as answer:
            answer.read()
    except OSError:
        return None
    return time.monotonic() - start


if __name__ == "__main__":
    sys.exit(main())
