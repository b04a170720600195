"""The links beside USB: the real firmware on its UART and over Wi-Fi, recorded by the real daemon."""

import socket

from recorded import SECONDS, judge, logged, recorder, stopped

from hubodo.emulator.board.settings import Clock, Flash, Host
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.log.hubodo_messages import decode_bytes_message
from hubodo.log.recording_reader import open_log
from hubowire import messages as m
from virtual_runs import FIRMWARE, messages_of, micropython_or_skip, unique_motion
from waiting import until


def test_a_node_on_its_uart_is_recorded_completely(tmp_path):
    micropython_or_skip()
    port, log = tmp_path / "ttyS0", tmp_path / "uart.mcap"
    config = {"link": "uart", "rate_hz": 416}
    host = Host("uart", path=port, wait=True)
    node = VirtualNode(unique_motion(30), Flash(FIRMWARE, config), clock=Clock("paced"), host=host)
    with node:
        daemon = recorder(port, log)
        until(lambda: node.stats["t"] > SECONDS or daemon.poll() is not None)
        done = stopped(daemon)
        truth = node.chip.truth()
        assert node.stats["calls"]["UART_INIT"] == 1
    judge(done, log, truth)


def test_a_node_on_wifi_sends_a_datagram_per_frame_and_is_recorded_completely(tmp_path):
    micropython_or_skip()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        number = free.getsockname()[1]
    log = tmp_path / "udp.mcap"
    config = {"link": "udp", "rate_hz": 416, "ssid": "net", "host": "127.0.0.1", "port": number}
    daemon = recorder(f"udp://127.0.0.1:{number}", log)
    until(lambda: log.exists() or daemon.poll() is not None)
    with VirtualNode(
        unique_motion(30), Flash(FIRMWARE, config), clock=Clock("paced"), host=Host("udp")
    ) as node:
        until(lambda: node.stats["t"] > SECONDS or daemon.poll() is not None)
        done = stopped(daemon)
        truth, stats = node.chip.truth(), node.stats
    judge(done, log, truth)
    with open_log(log) as records:
        raw = [
            decode_bytes_message("cdr", r.data)
            for r in records.messages()
            if r.topic.startswith("/hubodo/raw/")
        ]
    assert {data.count(0) for data in raw} == {1}
    assert stats["calls"]["UDP_SEND"] >= len(raw)
    assert messages_of(logged(log), m.Hello)[0].serial == bytes.fromhex("e6614103e7452d2f")
