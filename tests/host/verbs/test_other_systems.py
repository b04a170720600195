"""Recording, info, fuse and doctor run without the modules and functions that Python lacks on Windows."""

import contextlib
import json
import os
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from fakes.fake_node import FakeNode
from vehicles import vehicle_toml

ROOT = Path(__file__).resolve().parents[3]

RUN_WITHOUT_POSIX = """
import os, signal, sys
import serial, serial.tools.list_ports  # pyserial has a Windows part, which needs none of these
from hubodo.cli import main
for module in ("fcntl", "termios", "tty", "pty", "pwd", "grp", "resource", "readline", "syslog"):
    for name in [name for name in sys.modules if name == module]:
        del sys.modules[name]
    sys.modules[module] = None
for owner, names in (
    (os, "pread pwrite O_CLOEXEC O_NONBLOCK O_NOCTTY openpty ttyname setsid killpg fork sysconf".split()),
    (os, "getuid geteuid getgid getgroups fchmod posix_fallocate mkfifo getloadavg fdatasync".split()),
    (signal, "SIGHUP SIGKILL SIGALRM SIGUSR1 SIGUSR2 SIGPIPE SIGQUIT setitimer pthread_sigmask".split()),
    (__import__("socket"), ["AF_UNIX"]),
):
    for name in names:
        delattr(owner, name)
from hubodo.flash.computer import HostComputer
HostComputer.is_linux = False
for words in sys.argv[1].split("\\n"):
    code = main(words.split())
    if code:
        sys.exit(code)
"""


class Bridge:
    """A TCP server that forwards the bytes of a fake node."""

    def __init__(self, node):
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"socket://127.0.0.1:{self._server.getsockname()[1]}"
        self._fd = os.open(node.path, os.O_RDWR | os.O_NONBLOCK)
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._done.set()
        self._thread.join()
        os.close(self._fd)
        self._server.close()

    def _run(self):
        self._server.settimeout(20)
        peer, _ = self._server.accept()
        with contextlib.suppress(ConnectionError):
            while not self._done.wait(0.005):
                with contextlib.suppress(BlockingIOError):
                    peer.sendall(os.read(self._fd, 4096))
                with contextlib.suppress(BlockingIOError):
                    os.write(self._fd, peer.recv(4096, socket.MSG_DONTWAIT))
        peer.close()


def run(*lines, cwd):
    """Run each line as a `hubodo` command, in one process without the functions that Windows lacks."""
    environment = {**os.environ, "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}"}
    command = [sys.executable, "-c", RUN_WITHOUT_POSIX, "\n".join(lines)]
    return subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300, check=False
    )


@pytest.mark.real_time
def test_record_info_and_fuse_run_without_posix(tmp_path):
    (tmp_path / "v.toml").write_text(vehicle_toml(facing={"left": "left"}))
    with FakeNode(spin_raw=500) as node, Bridge(node) as bridge:
        done = run(
            f"record left={bridge.url} -o a.mcap --duration 2.5 --vehicle v.toml --log-format json --json",
            "info a.mcap --json",
            "fuse a.mcap --vehicle v.toml -o out",
            cwd=tmp_path,
        )
    assert done.returncode == 0, done.stderr
    entries = [json.loads(line) for line in done.stderr.splitlines() if line.startswith("{")]
    assert [entry["event"] for entry in entries][:1] == ["started"]
    recorded, info = (json.loads(line) for line in done.stdout.splitlines()[:2])
    assert recorded["nodes"]["left"]["samples"] > 200
    # On a busy computer the pseudo terminal may overflow: the fake node counts the frames it drops.
    assert recorded["nodes"]["left"]["samples_lost"] <= 8 * node.dropped
    assert info["complete"] is True
    assert (tmp_path / "out" / "track.csv").stat().st_size > 1000


def test_a_missing_serial_port_is_one_line_without_posix(tmp_path):
    done = run("record COM3 -o a.mcap", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("hubodo record: COM3: no such device; plug it in, or choose one of:")
    assert not list(tmp_path.iterdir())


def test_doctor_runs_without_posix(tmp_path):
    done = run("doctor --json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert {"clock", "disk", "packages"} <= {check["check"] for check in json.loads(done.stdout)["checks"]}
