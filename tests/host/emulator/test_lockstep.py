"""A lockstep board runs up to its limit, and the load of the host does not affect its output."""

import os
import tty

import pytest

from hubodo.emulator.board.settings import Clock, Flash, Host
from hubodo.emulator.interpreters.interpreter import InterpreterDied
from hubodo.emulator.virtual_node import VirtualNode
from hubowire import FrameDecoder, decode
from hubowire.messages import ImuBatch, TimeReply, TimeRequest
from virtual_runs import FIRMWARE, micropython_or_skip, request, unique_motion

SECONDS = 2.0


@pytest.fixture(autouse=True)
def _needs_micropython():
    micropython_or_skip()


def lockstep_node(tmp_path):
    config = {"node_id": 1, "rate_hz": 416}
    path = tmp_path / "tty"
    return VirtualNode(
        unique_motion(5), Flash(FIRMWARE, config), clock=Clock("lockstep"), host=Host(path=path)
    )


def run_in_steps(node, step, asked=b""):
    """Return [(ns, bytes)] that the node sends in steps of `step` s; asked: bytes sent by its host at 1 s."""
    host = os.open(node.port, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(host)
    output = []
    for number in range(round(SECONDS / step)):
        host_bytes = os.write(host, asked) if number == round(1.0 / step) else 0
        node.run_until((number + 1) * step, host_bytes)
        for t_ns, count in node.wait_for_limit():
            data = b""
            while len(data) < count:
                data += os.read(host, count - len(data))
            output.append((t_ns, data))
    os.close(host)
    return output


def messages(output, kind):
    decoder = FrameDecoder()
    pieces = [(t_ns, frame) for t_ns, data in output for frame in decoder.feed(data)]
    return [(t_ns, decode(f.type_id, f.payload)) for t_ns, f in pieces if f.type_id == kind.type_id]


def test_the_output_does_not_depend_on_the_step(tmp_path):
    runs = []
    for step in (0.01, 0.05):
        with lockstep_node(tmp_path) as node:
            runs.append(messages(run_in_steps(node, step), ImuBatch))
    assert len(runs[0]) > 50
    assert runs[0] == runs[1]


def test_bytes_of_the_host_arrive_before_the_board_continues(tmp_path):
    with lockstep_node(tmp_path) as node:
        output = run_in_steps(node, 0.01, request(1, TimeRequest(b"12345678")))
    ((t_ns, reply),) = messages(output, TimeReply)
    # While asleep, the firmware checks for bytes of its host every 4 ms.
    assert 1e9 <= t_ns < 1.01e9
    assert 1e6 <= reply.received_us <= reply.sent_us <= t_ns * 1e-3


def test_the_board_never_runs_past_its_limit(tmp_path):
    with lockstep_node(tmp_path) as node:
        assert all(t_ns <= SECONDS * 1e9 for t_ns, _ in run_in_steps(node, 0.05))
        assert node.stats["t"] <= SECONDS


def test_a_failure_of_the_board_is_raised_by_the_caller(tmp_path):
    with lockstep_node(tmp_path) as node:
        node.run_until(0.5, 0)
        node.wait_for_limit()
        os.kill(node.stats["interpreter_pid"], 9)
        with pytest.raises(InterpreterDied, match="ended"):
            node.run_until(1.0, 0)
            node.wait_for_limit()
