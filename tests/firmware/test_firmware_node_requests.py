"""Requests of the host to the complete node: settings, reboot to the prompt, ctrl-C."""

import shutil

import pytest

import hubowire
from hubodo.emulator.board.settings import Clock, Flash, Host
from hubodo.emulator.virtual_node import VirtualNode
from hubowire import messages as m
from virtual_runs import (
    FIRMWARE,
    match_samples,
    messages_of,
    micropython_or_skip,
    request,
    run,
    unique_motion,
)


def test_every_request_is_answered():
    token = b"hostTIME"
    requests = [
        m.GetHello(),
        m.Ping(),
        m.TimeRequest(token),
        m.SetConfig(m.ConfigKey.BATCH, 4),
        m.SetConfig(m.ConfigKey.RATE_HZ, 209),
        m.SetConfig(m.ConfigKey.FILTER_KIND, 3),
        m.SetConfig(99, 0),
        m.BiasInit(1999),
        m.Stop(),
        m.BiasInit(2000),
        m.Start(),
    ]
    script = [(1.0 + 0.1 * i, request(100 + i, message)) for i, message in enumerate(requests)]
    script.append((2.5, hubowire.encode_frame(hubowire.Frame(0x7F, 1, 200, b""))))
    script.append((2.6, request(201, m.Ping(), node=2)))
    script.append((2.7, b"\x05noise\x00"))
    sent, _, _ = run(4, script=script)
    acks = {(a.request, a.request_seq) for a in messages_of(sent, m.Ack)}
    assert acks == {
        (m.Ping.type_id, 101),
        (m.SetConfig.type_id, 103),
        (m.Stop.type_id, 108),
        (m.Start.type_id, 110),
    }
    nacks = {(n.request, n.request_seq, n.reason, n.detail) for n in messages_of(sent, m.Nack)}
    assert nacks == {
        (m.SetConfig.type_id, 104, m.Reason.BAD_VALUE, 209),
        (m.SetConfig.type_id, 105, m.Reason.BAD_VALUE, 3),
        (m.SetConfig.type_id, 106, m.Reason.BAD_VALUE, 99),
        (m.BiasInit.type_id, 107, m.Reason.BAD_VALUE, 1999),
        (m.BiasInit.type_id, 109, m.Reason.NO_IMU, 0),
        (0x7F, 200, m.Reason.UNKNOWN_MESSAGE, 0x7F),
    }
    (reply,) = messages_of(sent, m.TimeReply)
    assert reply.token == token
    assert 1.19e6 < reply.received_us <= reply.sent_us < 1.21e6
    batches = messages_of(sent, m.ImuBatch)
    assert {len(batch.samples) for batch in batches[-5:]} == {4}, "Start applies the new batch size"
    assert sum(batch.flags & 1 for batch in batches) == 1, "the pause is a gap"
    assert messages_of(sent, m.Health)[-1].samples_missed == 0, "nothing was missed while stopped"
    assert messages_of(sent, m.Health)[-1].frames_damaged == 1


def test_invalid_settings_are_replaced_by_defaults():
    config = {"rate_hz": "fast", "batch": 200, "node_id": 2, "unknown": 1}
    sent, _, _ = run(2, config=config)
    hello = messages_of(sent, m.Hello)[-1]
    assert (hello.rate_mhz, hello.batch) == (416_000, 16)
    assert {frame.node for frame, _ in sent} == {2}


@pytest.mark.parametrize("watchdog", [True, False])
def test_reboot_to_the_repl_ends_at_a_prompt_that_accepts_ctrl_c(watchdog):
    script = [(1.0, request(1, m.Reboot(m.RebootMode.REPL))), (3.0, b"\x03print(6 * 7)\r")]
    node = VirtualNode(
        unique_motion(12),
        Flash(FIRMWARE, {"watchdog": watchdog}),
        clock=Clock("stepped", run_for=12.0),
        host=Host("memory", script=script),
        own_process=False,
    )
    with node:
        node.wait(100)
        assert node.output.replace(b"\r", b"").endswith(b"42\n>>> ")
        assert len(node.stats["resets"]) == (1 if watchdog else 0)


@pytest.mark.parametrize("at", [0.0001, 0.0005, 0.002, 0.01])
def test_ctrl_c_while_booting_does_not_end_at_the_prompt(at):
    """Hosts may send ctrl-C, some of them twice."""
    script = [(at, b"\x03"), (at + 0.001, b"\x03"), (0.5, b"\0" + request(1, m.Ping()))]
    sent, truth, stats = run(1, script=script)
    assert stats["counts"].get("at_prompt", 0) == 0 and stats["resets"] == []
    assert [ack.request_seq for ack in messages_of(sent, m.Ack)] == [1]
    assert truth.t[int(match_samples(sent, truth)[-1, 0])] > 0.9


@pytest.mark.parametrize("link", ["usb", "uart"])
def test_a_firmware_that_fails_ends_at_a_prompt_that_accepts_ctrl_c(tmp_path, link):
    firmware = tmp_path / "firmware"
    shutil.copytree(FIRMWARE, firmware)
    (firmware / "reports.py").write_text(
        (FIRMWARE / "reports.py").read_text() + "\n\ndef health(node):\n    1 // 0\n"
    )
    micropython_or_skip()
    node = VirtualNode(
        unique_motion(4),
        Flash(firmware, {"link": link}, folder=tmp_path / "flash"),
        clock=Clock("stepped", run_for=4.0),
        host=Host("memory", script=[(2.0, b"\x03")]),
        own_process=False,
    )
    with node:
        node.wait(100)
        assert node.stats["counts"]["at_prompt"] == 1 and node.stats["resets"] == []


def test_ctrl_c_works_on_the_console_of_a_node_that_sends_by_uart():
    node = VirtualNode(
        unique_motion(3),
        Flash(FIRMWARE, {"link": "uart", "watchdog": False}),
        clock=Clock("stepped", run_for=3.0),
        host=Host("memory", script=[(1.5, b"\x03")]),
        own_process=False,
    )
    with node:
        node.wait(100)
        assert b"KeyboardInterrupt" in node.output and node.stats["counts"]["at_prompt"] == 1
