"""Summary of a log."""

import numpy as np
import pytest

from hubodo.log.log_writer import LogWriter
from hubodo.log.summary import summarise
from hubodo.recording import Event

PERIOD_NS = 5_000_000


def test_missing_samples_are_gaps_with_the_cause_in_the_log(tmp_path):
    t_ns = np.delete(np.arange(1000) * PERIOD_NS, slice(400, 405))
    with LogWriter(tmp_path / "log.mcap", t_zero_ns=0, clock=None) as log:
        log.write_imu("left", t_ns, t_ns, np.zeros((len(t_ns), 3)), np.zeros((len(t_ns), 3)))
        log.write_event(
            Event(399 * PERIOD_NS, "gap", "left", "", {"node": "left", "cause": "radio", "duration_s": 0.03})
        )
    summary = summarise(tmp_path / "log.mcap")
    (stream,) = (stream for stream in summary.streams if stream.topic == "/left/imu")
    (gap,) = stream.gaps
    assert (gap.missing, gap.cause, gap.t) == (5, "radio", pytest.approx(399 * 0.005))
    assert (stream.messages, stream.rate, stream.jitter) == (995, pytest.approx(200.0), 0.0)
    assert summary.complete and summary.damaged == 0 and summary.losses[0].cause == "radio"
