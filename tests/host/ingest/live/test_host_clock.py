"""After suspension or a clock step of the computer, the node's own clock and counters decide."""

import io
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from rich.console import Console

from fakes.fake_node import FakeNode
from fakes.script import Script
from hubodo.ingest.link.link import Chunk
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.host_clock import ClockState, HostClock, clock_state
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.ingest.node.clock import TICK_PERIOD_US
from hubodo.ingest.node.decoder import NodeDecoder
from hubodo.ingest.node.gaps import DAMAGED_BYTES, HOST_SUSPENDED, GapClassifier, LinkCounts, WireGap
from hubodo.log.recording_reader import open_log, read_recording
from hubodo.units import NS_PER_S
from hubowire import FINGERPRINT, Frame, encode
from hubowire.messages import Hello, ImuBatch
from in_process import hubodo

BATCH, PERIOD_NS = 16, 2_403_846
HELLO = Hello(
    FINGERPRINT, (1, 2, 3), b"serial01", 77, 1, 1, 416_000, 2000, 16,
    70_000_000, 488_000, 62_500, 25_000_000, 0, BATCH, 0, 40, (),
)  # fmt: skip
HELLO_FRAME = Frame(Hello.type_id, 1, 0, encode(HELLO))
LINK = LinkCounts()


def batch(number, start_us):
    """Return a batch, by number, of a node at 416 Hz whose clock started at start_us."""
    index = number * BATCH
    t_us = (start_us + index * PERIOD_NS // 1000) % TICK_PERIOD_US
    message = ImuBatch(t_us, PERIOD_NS, index & 0xFFFF, 0, 0, ((1, 2, 3, 4, 5, 6),) * BATCH)
    return Frame(ImuBatch.type_id, 1, number & 0xFFFF, encode(message))


def decoded(start_us, frames_lost, host_jump_s):
    """Return decoder and device times of 12 batches, with a loss and a host clock jump before the 7th."""
    decoder, out, host_ns = NodeDecoder("left"), [], 1_700_000_000 * NS_PER_S
    for k in range(12):
        number = k + frames_lost * (k >= 6)
        arrived_ns = host_ns + number * BATCH * PERIOD_NS + round(host_jump_s * NS_PER_S) * (k >= 6)
        if decoder.wants_hello:
            out += decoder.decode_frame(HELLO_FRAME, arrived_ns, LINK)
        out += decoder.decode_frame(batch(number, start_us), arrived_ns, LINK)
    out += decoder.decode_frame(HELLO_FRAME, arrived_ns, LINK)
    blocks = [block for block in out if hasattr(block, "device_ns")]
    return decoder, np.concatenate([block.device_ns for block in blocks])


@given(
    st.integers(0, TICK_PERIOD_US - 1),
    st.sampled_from([0, 1, 26, 700, 15_000, 30_000]),
    st.floats(-20_000, 20_000),
)
@example(0, 0, 600.0)
@example(0, 15_000, -577.0)  # the host's clock did not advance meanwhile
@example(0, 30_000, -1154.0)
def test_no_jump_of_the_hosts_clock_adds_or_hides_a_lost_sample(start_us, frames_lost, host_jump_s):
    """A jump by whole periods of the node's clock, within 0.1 %, is equivalent to silence of that length."""
    period_s = TICK_PERIOD_US * 1e-6
    assume(abs((host_jump_s + period_s / 2) % period_s - period_s / 2) > 30 or abs(host_jump_s) < 2)
    decoder, device_ns = decoded(start_us, frames_lost, host_jump_s)
    assert len(device_ns) == 12 * BATCH
    assert decoder.counts.samples_lost == frames_lost * BATCH
    np.testing.assert_allclose(
        device_ns[6 * BATCH] - device_ns[0], (frames_lost + 6) * BATCH * PERIOD_NS, atol=1000
    )


class JumpingComputer(VirtualComputer):
    """A computer whose clocks can be set: jump_ns on the monotonic axis, set_ns on the wall clock."""

    def __init__(self, state=ClockState.UNKNOWN):
        super().__init__(start_ns=1_780_000_000 * NS_PER_S)
        self.jump_ns, self.set_ns, self.state = 0, 0, state

    def now_ns(self):
        return super().now_ns() + self.jump_ns

    def wall_ns(self):
        return self.now_ns() + self.set_ns

    def clock_state(self):
        return self.state

    def put(self, item):
        super().put(replace(item, t_ns=item.t_ns + self.jump_ns) if isinstance(item, Chunk) else item)


def recorded(out, computer, duration, *script, node=None, console=None):
    """Return the result of a recording of one node with scripted actions, and its `clock` events."""
    Script(computer, *script)
    with node or FakeNode(rate_hz=416.0, batch=16, computer=computer) as node:
        config = RecordConfig(ports=(node.path,), duration=duration)
        result = record(config, out, computer=computer, console=console)
    events = read_recording(out).events
    return result.nodes["left"], [
        event for event in events if event.kind == "clock" and event.source == "computer"
    ]


def test_a_computer_that_stood_still_for_ten_minutes_is_one_event_and_no_lost_sample(tmp_path):
    computer, shown = JumpingComputer(), io.StringIO()
    script = (3.0, lambda: setattr(computer, "jump_ns", 600 * NS_PER_S))
    console = Console(file=shown, width=500)
    left, events = recorded(tmp_path / "ride.mcap", computer, 606.0, script, console=console)
    assert left["samples"] > 2300
    assert (left["samples_lost"], left["gaps"]) == (0, {})
    assert [round(event.data["standstill_s"]) for event in events] == [600]
    assert shown.getvalue().count("did not run for 600.0 s") == 1
    assert "no data for 5 s" not in shown.getvalue()
    # Samples use the new time soon, because the clock offset is measured again at once.
    times = read_recording(tmp_path / "ride.mcap").nodes["left"].t
    assert np.count_nonzero(np.diff(times) > 1.0) == 1
    assert times[-1] == pytest.approx(606.0, abs=0.3)
    assert np.count_nonzero(times > 590) > 2.0 * 416


def test_samples_sent_during_a_standstill_of_the_computer_are_counted(tmp_path):
    """The node drops 390 frames in 15 s of suspension during which the computer's clock continues."""
    computer = JumpingComputer()
    node = FakeNode(rate_hz=416.0, batch=16, computer=computer)

    def suspend():
        node.lose(390)
        node._t0 -= 15.0
        computer.jump_ns += 15 * NS_PER_S

    left, _ = recorded(tmp_path / "ride.mcap", computer, 22.0, (3.0, suspend), node=node)
    assert left["samples_lost"] == 390 * 16
    assert left["gaps"] == {HOST_SUSPENDED: 1}
    again = tmp_path / "again.mcap"
    assert hubodo("import", tmp_path / "ride.mcap", "-o", again).code == 0
    gaps = [event.data for event in read_recording(again).events if event.kind == "gap"]
    assert [(gap["samples_lost"], gap["cause"]) for gap in gaps] == [(390 * 16, HOST_SUSPENDED)]


def test_a_paused_machine_whose_clock_stood_still_with_it_has_every_lost_sample_counted(tmp_path):
    """The node drops 18,200 frames in 700 s; the log's time axis does not advance, the wall clock is set."""
    computer = JumpingComputer()
    node = FakeNode(rate_hz=416.0, batch=16, computer=computer)

    def pause():
        node.lose(18_200)
        node._t0 -= 700.0
        computer.set_ns += 700 * NS_PER_S

    left, events = recorded(tmp_path / "ride.mcap", computer, 12.0, (3.0, pause), node=node)
    assert left["samples_lost"] == 18_200 * 16
    assert left["samples"] > 4_000
    assert [event.data["step_s"] for event in events] == [700.0]
    assert (np.diff(read_recording(tmp_path / "ride.mcap").nodes["left"].t) > 0).all()


def test_a_frame_cut_in_two_by_a_standstill_is_due_to_it_and_one_in_an_instant_is_damaged():
    ledger, before, now = GapClassifier("left"), LinkCounts(), LinkCounts(damaged_frames=1)
    start_ns = 10 * NS_PER_S
    # Data buffered on the line is read and stamped when the computer resumes.
    long, short = (
        WireGap("ImuBatch", 17 * NS_PER_S, 17 * NS_PER_S + 1, 3, 24, (start_ns, start_ns + lasts_ns))
        for lasts_ns in (6 * NS_PER_S, NS_PER_S)
    )
    (event,) = ledger.add(short, before, now)
    assert event.data["cause"] == DAMAGED_BYTES
    assert list(ledger.add(long, before, now)) == []
    ledger.note_host_suspension(10 * NS_PER_S, 17 * NS_PER_S - 2)
    assert [event.data["cause"] for event in ledger.close()] == [HOST_SUSPENDED]
    assert list(ledger.add(long, before, now)) == []
    ledger.note_host_suspension(100 * NS_PER_S, 107 * NS_PER_S)
    assert [event.data["cause"] for event in ledger.close()] == [DAMAGED_BYTES]


@pytest.mark.parametrize("step", [3.0, -7200.0])
def test_a_wall_clock_that_is_set_is_an_event_with_its_size_and_moves_no_sample(tmp_path, step):
    out, computer, shown = tmp_path / "ride.mcap", JumpingComputer(ClockState.UNSYNCHRONISED), io.StringIO()

    def set_clock():
        computer.set_ns, computer.state = int(step * NS_PER_S), ClockState.SYNCHRONISED

    _, events = recorded(out, computer, 6.0, (3.0, set_clock), console=Console(file=shown, width=500))
    assert [event.data.get("step_s") for event in events] == [None, step, None]
    assert [event.data.get("state") for event in events] == ["unsynchronised", None, "synchronised"]
    assert f"set {'forward' if step > 0 else 'back'} by {abs(step):.3f} s" in shown.getvalue()
    assert np.diff(read_recording(out).nodes["left"].t).max() < 0.01
    with open_log(out) as log:
        assert log.metadata_records["clock"] == {"state": "synchronised", "utc_minus_log_s": f"{step:.3f}"}
    assert f"UTC is t {step:+.3f} s" in hubodo("info", out).out


def test_a_log_with_an_unset_clock_is_marked_and_info_reports_it(tmp_path):
    out, computer = tmp_path / "ride.mcap", JumpingComputer(ClockState.UNSET)
    _, events = recorded(out, computer, 1.0)
    assert "is not set, it shows 2026-05-28" in events[0].text
    with open_log(out) as log:
        assert log.metadata_records["clock"]["state"] == "unset"
    assert "the computer's clock was unset" in hubodo("info", out).out


def test_the_state_of_a_clock_follows_from_its_time_and_timesyncd(tmp_path):
    folder = tmp_path / "timesync"
    now_ns = 1_780_000_000 * NS_PER_S
    assert clock_state(1_000 * NS_PER_S, folder) == "unset"
    assert clock_state(now_ns, folder) == "unknown"
    folder.mkdir()
    assert clock_state(now_ns, folder) == "unsynchronised"
    (folder / "synchronized").touch()
    assert clock_state(now_ns, folder) == "synchronised"
    assert clock_state(1_000 * NS_PER_S, folder) == "unset"


def test_a_step_of_the_wall_clock_beyond_a_tenth_of_a_second_is_an_event_and_less_is_none():
    computer = JumpingComputer()
    clock, steps = HostClock(computer), []
    for second, set_s in enumerate((0.0, 0.05, 0.09, 0.2, 0.2, -3.0)):
        computer.set_ns = round(set_s * NS_PER_S)
        steps += [event.data["step_s"] for event in clock.tick(computer.now_ns() + second * NS_PER_S)]
    assert steps == [0.2, -3.2]
    assert clock.metadata == {"state": "unknown", "utc_minus_log_s": "-3.000"}


def test_a_process_interrupted_between_two_readings_reports_no_step():
    """The wall clock is read 0.3 s late, as on a busy computer."""

    class Interrupted(JumpingComputer):
        def wall_ns(self):
            self.jump_ns += 3 * NS_PER_S // 10
            return super().wall_ns()

    computer = Interrupted()
    clock = HostClock(computer)
    assert [event for k in range(20) for event in clock.tick(computer.now_ns() + k * NS_PER_S)] == []
