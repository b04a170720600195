"""Small programs for the virtual board, and a host that reads its terminal."""

from __future__ import annotations

import os
import select
import time
from pathlib import Path

STREAM_FIFO = """
import machine, sys, time, select
i2c = machine.I2C(0, scl=machine.Pin(5), sda=machine.Pin(4), freq=400000)
w = bytearray(1)
def put(r, v):
    w[0] = v
    i2c.writeto_mem(0x6B, r, w)
put(0x12, 0x44); put(0x08, 0x09); put(0x0A, %(odr)d << 3 | 6)
put(0x10, %(odr)d << 4 | 4); put(0x11, %(odr)d << 4 | 12)
status = bytearray(4)
rows = memoryview(bytearray(12 * 16))
parts = [rows[:12 * n] for n in range(17)]
out = sys.stdout.buffer.write
poll = select.poll()
poll.register(sys.stdin, select.POLLIN)
made = 0
while made < %(n)d:
    for _ in poll.ipoll(0):
        sys.stdin.buffer.read(1)
    i2c.readfrom_mem_into(0x6B, 0x3A, status)
    n = (status[0] | (status[1] & 15) << 8) // 6
    if n > 16:
        n = 16
    if n >= %(batch)d:
        i2c.readfrom_mem_into(0x6B, 0x3E, parts[n])
        out(parts[n])
        made += n
    time.sleep_us(%(nap)d)
time.sleep_ms(50)
"""

STREAM_POLLED = """
import machine, sys, time
i2c = machine.I2C(0, scl=machine.Pin(5), sda=machine.Pin(4), freq=400000)
w = bytearray(1)
def put(r, v):
    w[0] = v
    i2c.writeto_mem(0x6B, r, w)
put(0x12, 0x44); put(0x10, 0x54); put(0x11, 0x5C)
status = bytearray(1)
row = bytearray(12)
out = sys.stdout.buffer.write
for k in range(%(n)d):
    while True:
        i2c.readfrom_mem_into(0x6B, 0x1E, status)
        if status[0] & 3 == 3:
            break
        time.sleep_us(300)
    i2c.readfrom_mem_into(0x6B, 0x22, row)
    out(row)
    time.sleep_us(3800)
"""

# Six digits and a line end every 2 ms.
CHATTER = """
import sys, time
n = 0
while True:
    sys.stdout.buffer.write(b'%06d\\n' % n)
    n += 1
    time.sleep_ms(2)
"""


def firmware(folder: Path, **files: str) -> Path:
    """A firmware directory with `<name>.py` for each file."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / f"{name}.py").write_text(text)
    return folder


class Terminal:
    """A host on the port that reads without blocking for ever, and writes."""

    def __init__(self, port: str, timeout: float = 30.0) -> None:
        end = time.monotonic() + timeout
        while True:
            try:
                self._fd = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                break
            except FileNotFoundError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.01)
        self.data = b""

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._fd)

    def write(self, data: bytes) -> None:
        os.write(self._fd, data)

    def pump(self, seconds: float = 0.05) -> bool:
        """Read the available data; return False once the terminal has hung up."""
        if select.select([self._fd], [], [], seconds)[0]:
            try:
                got = os.read(self._fd, 65536)
            except OSError:
                return False
            self.data += got
            return bool(got)
        return True

    def until(self, end: bytes, timeout: float = 30.0) -> bytes:
        """Return the output up to and including `end`; later output stays buffered."""
        limit = time.monotonic() + timeout
        while end not in self.data:
            assert time.monotonic() < limit, f"no {end!r} in {self.data[-500:]!r}"
            assert self.pump(), f"hung up after {self.data[-500:]!r}"
        head, _, self.data = self.data.partition(end)
        return head + end
