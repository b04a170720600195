"""A delayed host reads late, but samples keep the node's own times."""

from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from fakes.fake_node import FakeNode
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.log.recording_reader import read_recording
from hubodo.units import NS_PER_S
from repetitions import each_value_first

RATE_HZ = 208.0


class StarvedComputer(VirtualComputer):
    """A computer stopped in some intervals (start s, end s): data is read at their ends."""

    def __init__(self, stretches):
        super().__init__()
        zero_ns = self.now_ns()
        self._stretches = [
            (zero_ns + round(a * NS_PER_S), zero_ns + round(b * NS_PER_S)) for a, b in stretches
        ]

    def put(self, item):
        super().put(replace(item, t_ns=self._awake(item.t_ns)))

    def _step(self, t_ns):
        super()._step(self._awake(t_ns))

    def _awake(self, t_ns):
        return next((end for start, end in self._stretches if start < t_ns < end), t_ns)


class LaggingComputer(VirtualComputer):
    """A computer that reads all data late, by the delay of a polyline of (time sent s, delay s)."""

    def __init__(self, delays):
        super().__init__()
        self._zero_ns, self._delays, self._unread = self.now_ns(), np.array(delays, float), deque()

    def put(self, item):
        delay = np.interp((item.t_ns - self._zero_ns) / NS_PER_S, *self._delays.T)
        self._unread.append(replace(item, t_ns=item.t_ns + round(delay * NS_PER_S)))

    def _step(self, t_ns):
        super()._step(t_ns)
        while self._unread and self._unread[0].t_ns <= self._now_ns:
            super().put(self._unread.popleft())


def often(seed):
    """Return intervals of up to 0.1 s that cover half of the time."""
    rng = np.random.default_rng(seed)
    edges = np.cumsum(rng.uniform(0.0, 0.1, 400))
    return list(zip(edges[::2], edges[1::2], strict=True))


# The first clock request is sent 30 ms after the start.
@pytest.mark.parametrize(
    "stretches",
    [
        pytest.param([(0.0302, 1.5)], id="at the first question"),
        pytest.param([(0.0302, 0.35), (0.3702, 0.6)], id="twice at the start", marks=pytest.mark.repeat),
        pytest.param([(3.0, 5.0)], id="on the way", marks=pytest.mark.repeat),
        pytest.param(often(1), id="often"),
        pytest.param(often(2), id="often, again", marks=pytest.mark.repeat),
    ],
)
def test_intervals_stay_those_of_the_node_to_100_ppm(tmp_path, stretches):
    out, computer = tmp_path / "ride.mcap", StarvedComputer(stretches)
    start = computer.now_ns()
    with FakeNode(computer=computer) as node:
        record(RecordConfig(ports=(node.path,), duration=12.0), out, computer=computer)
    log = read_recording(out)
    t = log.nodes["left"].t + (log.t_zero_ns - start) * 1e-9
    true = np.arange(len(t)) / RATE_HZ
    print(f"times off by {np.abs(t - true).max():.6f} s at most")
    # Time stamps of the node are in whole us.
    assert np.abs(np.diff(t) - 1 / RATE_HZ).max() < 1e-4 / RATE_HZ + 2e-6
    assert np.abs((t[208:] - t[:-208]) - 1.0).max() < 1e-4 + 2e-6
    assert np.abs(t - true).max() < 1e-3


DELAYS = {
    "for ten seconds": ([(3, 0), (7, 3.5), (14, 3.5), (17, 0)], 0.006, 1e-4),
    # A delay that is there from the start shows once the node answers, or the delay shrinks.
    "from the start": ([(0, 4), (4, 4), (8, 0)], 4.006, 1.01e-3),
    "by 0.4 s": ([(2, 0), (2.5, 0.4), (9, 0.4), (9.3, 0)], 0.006, 1e-4),
}


@pytest.mark.parametrize(("delay", "answers"), each_value_first(tuple(DELAYS), (True, False)))
def test_data_read_seconds_late_leaves_the_rate_of_the_samples_as_it_was(tmp_path, delay, answers):
    delays, max_error, max_stretch = DELAYS[delay]
    out, computer = tmp_path / "ride.mcap", LaggingComputer(delays)
    start = computer.now_ns()
    with FakeNode(computer=computer, answers=answers) as node:
        record(RecordConfig(ports=(node.path,), duration=24.0), out, computer=computer)
    log = read_recording(out)
    t = log.nodes["left"].t + (log.t_zero_ns - start) * 1e-9
    late = t - np.arange(len(t)) / RATE_HZ
    print(f"times late by {late.min():.6f} to {late.max():.6f} s, in the end {late[-1]:.6f} s")
    if answers:
        max_error, max_stretch = 1e-3, 1e-4
    assert np.abs(np.diff(t) - 1 / RATE_HZ).max() < max_stretch / RATE_HZ + 2e-6
    assert np.abs(late).max() < max_error
