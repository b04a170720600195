"""A node recorded by the real daemon for some seconds of virtual time, and the checks of the log."""

import json
import signal
import subprocess
import sys

import numpy as np

from hubodo.log.hubodo_messages import decode_bytes_message
from hubodo.log.recording_reader import open_log
from hubowire import FrameDecoder, decode
from virtual_runs import match_samples

SECONDS = 4


def recorder(port, log, *more):
    """Start a daemon on `port` with additional arguments `more`."""
    words = ("record", str(port), "-o", str(log), "--json", *more)
    return subprocess.Popen(
        [sys.executable, "-m", "hubodo.cli", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def stopped(daemon):
    """Stop a daemon and return its standard output and standard error."""
    daemon.send_signal(signal.SIGINT)
    return daemon.communicate(timeout=300)


def logged(log):
    """Return [(frame, message)] of all logged frames."""
    decoder = FrameDecoder()
    with open_log(log) as records:
        raw = [
            decode_bytes_message("cdr", r.data)
            for r in records.messages()
            if r.topic.startswith("/hubodo/raw/")
        ]
    return [(f, decode(f.type_id, f.payload)) for data in raw for f in decoder.feed(data)]


def judge(done, log, truth, seconds=SECONDS):
    """Check that nothing is lost, each sample equals the chip's, and the node received the host."""
    out, errors = done
    result = json.loads(out) if out else errors
    (node,) = result["nodes"].values()
    assert (node["samples_lost"], node["frames_lost"], node["gaps"]) == (0, 0, {})
    (link,) = result["links"].values()
    assert link["frames_damaged"] == 0
    assert node["clock"]["source"] == "two way" and node["clock"]["exchanges"] >= 1
    matches = match_samples(logged(log), truth)
    assert len(matches) > 0.8 * (seconds - 1) * 416
    places, numbers = np.diff(matches[:, 0]), np.diff(matches[:, 2])
    hole = np.flatnonzero((places != 1) | (numbers != 1))
    assert not len(hole), (
        f"after sample {hole[0]}: {places[hole[0]]:.0f} on, by number {numbers[hole[0]]:.0f}"
    )
    return node
