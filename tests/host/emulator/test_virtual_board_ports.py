"""The virtual board's other ports: UDP, a UART, the console of an ESP32."""

from __future__ import annotations

from pathlib import Path

import pytest
from board_programs import firmware
from board_runs import printed, run

from hubodo.emulator.board.settings import BoardSettings, Flash, Host
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode


def test_udp_datagrams_pass_in_both_directions(tmp_path: Path) -> None:
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("127.0.0.1", 0))
        host.settimeout(10)
        program = f"""
import network, socket, time, sys
w = network.WLAN(network.STA_IF); w.active(True); w.connect('net', 'key')
while not w.isconnected(): time.sleep_ms(10)
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.setblocking(False)
s.connect(('127.0.0.1', {host.getsockname()[1]}))
s.write(bytearray(b'xxhelloxx'), 2, 5)
buf = bytearray(20); n = None
while not n: n = s.readinto(buf)
s.write(buf, n)
"""
        node = VirtualNode(StillMotion(), Flash(firmware(tmp_path / "fw", main=program)), host=Host("udp"))
        with node:
            data, peer = host.recvfrom(100)
            assert data == b"hello"
            host.sendto(b"answer", peer)
            assert host.recv(100) == b"answer"


@pytest.mark.parametrize("port", ["rp2", "esp32"])
def test_a_uart_holds_a_write_up_until_all_of_it_is_in_its_buffer(tmp_path: Path, port: str) -> None:
    """Both ports block; only rp2 reports beforehand whether there is space."""
    program = """
import machine, time, select
u = machine.UART(0, baudrate=9600, txbuf=64)
p = select.poll(); p.register(u, select.POLLOUT)
print('x')
before = time.ticks_us()
a = u.write(bytearray(100)); full = len(p.poll(0))
took = time.ticks_diff(time.ticks_us(), before)
time.sleep_ms(300)
with open('/r', 'w') as f: f.write('%d %d %d %d' % (a, full, len(p.poll(0)), took))
"""
    node = run(
        tmp_path,
        program,
        1.0,
        board=BoardSettings(uart_link=0, model={"rp2": "pico", "esp32": "esp32"}[port]),
        flash=Flash(folder=tmp_path / "flash"),
    )
    assert len(node.output) == 100
    node.stop()
    *counts, took_us = map(int, (tmp_path / "flash" / "r").read_text().split())
    assert counts == [100, int(port == "esp32"), 1]
    assert took_us == pytest.approx((100 - 64) * 10 / 9600 * 1e6, abs=200)


def test_the_console_of_an_esp32_is_a_blocking_uart(tmp_path: Path) -> None:
    program = """
import time, select, sys
p = select.poll(); p.register(sys.stdout, select.POLLOUT)
before = time.ticks_us()
for _ in range(8): sys.stdout.buffer.write(bytes(64)); ready = len(p.poll(0))
print(sys.platform, ready, time.ticks_diff(time.ticks_us(), before))
"""
    platform, ready, took_us = (
        printed(run(tmp_path, program, 1.0, board=BoardSettings(model="esp32")))[0].strip("\0").split()
    )
    assert (platform, ready) == ("esp32", "1")
    assert int(took_us) == pytest.approx((512 - 128) * 10 / 115200 * 1e6, abs=500)
