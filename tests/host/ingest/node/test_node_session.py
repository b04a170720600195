"""A node that sends reports but no samples of its IMU and no clock replies."""

from dataclasses import replace

import numpy as np
import pytest

from faults.line import BATCH, PERIOD_NS, T0, Line, Node
from hubodo.log.records import Battery, BiasFilterRow, HighGSamples, ImuBlock
from hubodo.units import NS_PER_S
from hubowire import FrameDecoder, decode
from hubowire.messages import Board, Fault, Filter, Health, HighG, Signal, TimeReply, TimeRequest

PERIOD = 1 << 30


def health(t_us, battery_mv=3700):
    return Health(t_us, battery_mv, 0, 0, 0, 0, 0, 0, 0, 1, 900, 1, 50_000, 40)


def report_times(sink):
    """Return the host times of batteries and filter reports, ns."""
    return [int(record.t_ns[0]) for record in sink.records if isinstance(record, Battery | BiasFilterRow)]


def test_a_battery_report_without_samples_has_the_time_of_reception():
    line, node = Line(), Node()
    line.receive(node.hello_frame())
    for second in range(3):
        line.receive(node.frame(health(second * 1_000_000)), seconds=1.0)
    line.close()
    assert report_times(line.sink) == pytest.approx([T0 + k * NS_PER_S for k in range(3)], abs=0.1 * NS_PER_S)


@pytest.mark.parametrize(
    "last", [Filter(PERIOD - 1, 2, 0, 9, (1, 0, 0), (0, 0, 0), (1, 0, 1), (4, 4, 8)), None]
)
def test_a_wrap_of_the_microseconds_gives_no_negative_time(last):
    line, node = Line(), Node()
    line.receive(node.hello_frame())
    line.receive(node.frame(health(0)), seconds=1.0)
    line.receive(node.frame(last or health(PERIOD - 1)), seconds=1.0)
    line.receive(node.frame(health(2_000_000)), seconds=1.0)
    sink = line.close()
    assert "fault" not in sink.kinds()
    assert len(report_times(sink)) == 3
    assert all(abs(t_ns - T0) < 10 * NS_PER_S for t_ns in report_times(sink))


def test_samples_of_a_second_accelerometer_are_logged_in_si_at_their_times():
    line, node = Line(), Node()
    line.receive(node.hello_frame())
    samples = ((100, -200, 20), (101, -201, 21), (102, -202, 22))
    for number in range(4):
        frame = node.frame(HighG(100_000 + 7_500 * number, 2_500_000, 49_000_000, samples))
        if number != 2:
            line.receive(frame, seconds=0.0075)
    sink = line.close()
    blocks = [record for record in sink.records if isinstance(record, HighGSamples)]
    assert {block.node for block in blocks} == {"left"}
    t_ns = np.concatenate([block.t_ns for block in blocks])
    assert np.diff(t_ns).tolist() == pytest.approx([2.5e6] * 5 + [10e6] + [2.5e6] * 2)
    assert blocks[0].accel[:, 1] == pytest.approx(np.array([-200, -201, -202]) * 0.049 * 9.80665)


def test_samples_that_were_read_seconds_late_are_reported_once_and_a_constant_lag_is_not():
    line, node = Line(), Node()
    line.receive(node.hello_frame())
    for _ in range(200):  # 7.7 s at a constant lag, which nothing shows
        line.receive(node.batch())
    assert "lag" not in line.sink.kinds()
    for _ in range(65):  # a lag of 2.5 s ends
        line.receive(node.batch(), seconds=0.0)
    for _ in range(400):
        line.receive(node.batch())
    line.close()
    (event,) = [event for event in line.sink.events if event.kind == "lag"]
    assert event.data["lag"] == pytest.approx(2.5, abs=0.1)
    assert event.data["duration_s"] == pytest.approx(2500.0, rel=0.03)
    assert "2.5 s late" in event.text and "for 42 min" in event.text


class SleepingNode:
    """A node that answers clock requests while it is awake; its clock is `ahead` of the line's time."""

    DELAY_S = 0.002

    def __init__(self, board):
        self.line, self.node = Line(), Node()
        self.node.hello = replace(self.node.hello, board=int(board))
        self.ahead_s, self.is_awake, self.blocks = 0.0, True, []
        self.line.recorder._send = self.answer
        store = self.line.sink.write_record
        self.line.sink.write_record = lambda record: (
            self.blocks.append(record) if isinstance(record, ImuBlock) else store(record)
        )
        self.replies = []

    def clock_us(self, before_s=0.0):
        return round((self.line.now - T0) / 1000 + (self.ahead_s - before_s) * 1e6)

    def answer(self, label, data, to=None):
        for frame in FrameDecoder().feed(data):
            message = decode(frame.type_id, frame.payload)
            if isinstance(message, TimeRequest) and self.is_awake:
                at_us = self.clock_us(-self.DELAY_S)
                self.replies.append(TimeReply(message.token, at_us % PERIOD, (at_us + 100) % PERIOD))
        return True

    def receive(self, message):
        self.line.receive(self.node.frame(message), seconds=0.0)

    def measure(self, count, late_s=0.0):
        """Send batches that were measured `late_s` ago, and the replies that are due."""
        for _ in range(count):
            seconds = BATCH * PERIOD_NS / NS_PER_S
            self.node.clock_us = self.clock_us(late_s + seconds) - self.node.index * PERIOD_NS // 1000
            self.line.receive(self.node.batch(), seconds=2 * self.DELAY_S)
            for reply in self.replies:
                self.receive(reply)
            self.replies = []
            self.line.receive(b"", seconds=seconds - 2 * self.DELAY_S)


@pytest.mark.parametrize(
    ("board", "rate_error"), [(Board.ESP32_S3, -0.01), (Board.ESP32_S3, 0.01), (Board.PICO, 0.0)]
)
def test_samples_after_a_sleep_by_an_rc_oscillator_have_their_true_times(board, rate_error):
    """A Pico sleeps by its crystal; an ESP32 is wrong by 1 %, which is 4 s after seven minutes."""
    node = SleepingNode(board)
    node.line.receive(node.node.hello_frame())
    node.measure(100)
    node.is_awake = False
    for _ in range(100):
        node.receive(replace(health(node.clock_us() % PERIOD), faults=int(Fault.ASLEEP)))
        node.line.wait(4.0)
        node.ahead_s += 4.0 * rate_error
    node.is_awake = True
    woken_ns = node.line.now
    node.measure(1, late_s=3.0)  # the FIFO holds samples from before the end of the sleep
    node.line.receive(node.node.hello_frame(), seconds=0.001)
    node.receive(health(node.clock_us() % PERIOD))
    node.measure(200)
    node.line.close()
    assert "fault" not in node.line.sink.kinds()
    after = [block for block in node.blocks if block.received_ns >= woken_ns]
    assert len(after) == 201
    last_ns = np.array([block.t_ns[-1] for block in after])
    due_ns = np.array([block.received_ns for block in after]) - PERIOD_NS
    due_ns[0] -= 3 * NS_PER_S
    assert np.abs(last_ns - due_ns).max() < 5e6


@pytest.mark.parametrize(
    ("per_report", "behind_receiver", "n_warnings"), [(5, True, 1), (2, True, 0), (5, False, 0)]
)
def test_a_node_whose_radio_cannot_send_its_frames_is_reported_once(per_report, behind_receiver, n_warnings):
    line, node, receiver = Line(), Node(), Node(node_id=200)
    line.receive(receiver.frame(replace(receiver.hello, boot_id=5, serial=b"receiver")))
    line.receive(node.hello_frame())
    for second in range(10):
        if behind_receiver:
            line.receive(receiver.frame(Signal(second * 1_000_000, 1, 10, 0, 40, 0, 40, 0, 0)))
        report = health(second * 1_000_000)
        line.receive(node.frame(replace(report, frames_dropped=per_report * second)), seconds=1.0)
    line.close()
    warnings = [event for event in line.sink.events if event.kind == "warning" and event.source == "left"]
    assert len(warnings) == n_warnings
    assert all("choose another channel, a lower rate_hz, or a second receiver" in w.text for w in warnings)
