"""A recorder killed at any time: all data older than one second is recovered, and nothing else.

Each recorder is forked off this process, so that two hundred of them take little more than their waiting
time: `make faults` uses --kills 200.
"""

import itertools
import os
import random
import signal
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hubodo.log.disk_space import RotationRules
from hubodo.log.log_names import LogNames
from hubodo.log.log_series import LogSeries
from hubodo.log.log_writer import LogWriter
from hubodo.log.logfile import LogMessage, open_log
from hubodo.log.recover import recover_log
from hubodo.units import NS_PER_S

PARALLEL_RUNS = 10
STEP_S = 0.01


def record_for_ever(path: Path, reported: int, silent_after: float) -> None:
    """Write rows with their time of reception, reported on a pipe, then only ticks."""
    log, i, n, start = LogWriter(path), 0, 8, time.monotonic()
    while True:
        if time.monotonic() - start < silent_after:
            rows = np.repeat(np.arange(i, i + n, dtype=float)[:, None], 3, axis=1)
            now = time.time_ns()
            log.write_imu("left", now + np.arange(n), now, rows, rows)
            i += n
            os.write(reported, f"{now} {i}\n".encode())
        log.tick()
        time.sleep(STEP_S)


def rotate_for_ever(out: Path, report: int, steps: int) -> None:
    """Record into logs of `steps` steps each; the end of a step is reported with a number of -1."""
    series = LogSeries(out, RotationRules(max_duration=3600.0), time.time_ns)
    log, i, n = LogWriter(series, clock=time.time_ns), 0, 8
    for step in itertools.count(1):
        rows = np.repeat(np.arange(i, i + n, dtype=float)[:, None], 3, axis=1)
        now = time.time_ns()
        i += n
        os.write(report, f"{now} {i}\n".encode())
        log.write_imu("left", now + np.arange(n), now, rows, rows)
        if step % steps == 0:
            log.flush()
            series.rotate()
        log.tick()
        series.tick(now)
        os.write(report, f"{now} -1\n".encode())
        time.sleep(STEP_S / 5)


def start(recorder: Callable[..., None], path: Path, option: float) -> tuple[int, int]:
    """Start the process of a recorder; return it with its pipe."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(reader)
            recorder(path, writer, option)
        finally:
            os._exit(1)
    os.close(writer)
    return child, reader


def received(reader: int) -> list[tuple[int, int]]:
    with os.fdopen(reader) as stream:
        rows = [line.split() for line in stream.read().splitlines()]
    return [(int(row[0]), int(row[1])) for row in rows if len(row) == 2]


@pytest.fixture
def kills(request: pytest.FixtureRequest) -> int:
    return int(request.config.getoption("--kills"))


def test_after_sigkill_all_data_up_to_one_second_before_is_recovered(
    kills: int, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    seed = 7
    rng = random.Random(seed)
    lost_most = 0.0
    for first in range(0, kills, PARALLEL_RUNS):
        running, began = [], time.monotonic()
        for number in range(first, min(first + PARALLEL_RUNS, kills)):
            silent = rng.choice((99.0, 0.4))
            child, reader = start(record_for_ever, tmp_path / f"{number}.mcap", silent)
            running.append((began + rng.uniform(0.0, 1.8), number, child, reader, silent))
        for moment, number, child, reader, silent in sorted(running):
            time.sleep(max(0.0, moment - time.monotonic()))
            killed_ns = time.time_ns()
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            rows = received(reader)
            due = max([i for now, i in rows if now <= killed_ns - 1_000_000_000], default=0)
            values = recovered(tmp_path / f"{number}.mcap", tmp_path / f"{number}-out.mcap")
            where = f"seed {seed}, kill {number}, {moment - began:.3f} s, silent after {silent}"
            assert values == list(range(len(values))), where
            assert len(values) >= due, f"{len(values)} of {due} due, {where}"
            behind = [killed_ns - now for now, i in rows if i > len(values)]
            lost_most = max(lost_most, max(behind, default=0) / 1e9)
    record_property("figure", f"{kills} kills, seed {seed}: nothing older than {lost_most:.2f} s was lost")


def test_a_kill_during_rotation_loses_half_a_second_and_earlier_logs_are_complete(
    kills: int, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    """Data 0.5 s old at the end of the last step is in a log; half of the recorders rotate at each step."""
    seed, lost_most, logs = 11, 0.0, 0
    rng = random.Random(seed)
    for first in range(0, kills, PARALLEL_RUNS):
        running, began = [], time.monotonic()
        for number in range(first, min(first + PARALLEL_RUNS, kills)):
            steps = (1, 150)[number % 2]
            child, reader = start(rotate_for_ever, tmp_path / f"{number}.mcap", steps)
            running.append((began + rng.uniform(0.1, 1.0), number, child, reader))
        for moment, number, child, reader in sorted(running):
            time.sleep(max(0.0, moment - time.monotonic()))
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            reports = received(reader)
            last_step = max((now for now, i in reports if i < 0), default=0)
            due = max((i for now, i in reports if now <= last_step - NS_PER_S // 2), default=0)
            paths = LogNames(tmp_path / f"{number}.mcap", plain=False).existing_logs()
            logs += len(paths)
            where = f"seed {seed}, kill {number}"
            values = [value for path in paths[:-1] for value in values_of_complete_log(path, where)]
            values += [value for path in paths[-1:] for value in recovered(path, path.with_suffix(".whole"))]
            assert values == list(range(len(values))), where
            assert len(values) >= due, f"{len(values)} of {due} due, {where}"
            behind = [last_step - now for now, i in reports if i > len(values)]
            lost_most = max(lost_most, max(behind, default=0) / 1e9)
    figure = f"{kills} kills in {logs} logs, seed {seed}: nothing older than {lost_most:.2f} s was lost"
    record_property("figure", figure)


def values_of_complete_log(path: Path, where: str) -> list[float]:
    """Return the numbers of the samples of a log that must be read without a warning."""
    with open_log(path) as log:
        values = [first_value(m) for m in log.messages() if m.topic == "/left/imu"]
        assert log.warnings() == (), where
    return values


def recovered(path: Path, out: Path) -> list[float]:
    """Return the numbers of the recovered samples; none where the file had no header."""
    if not path.exists() or path.stat().st_size < 8:
        return []
    recover_log(path, out)
    with open_log(out) as log:
        return [first_value(m) for m in log.messages(["/left/imu"])]


def first_value(imu: LogMessage) -> float:
    """Return the number that a recorder wrote as the angular rate about x of a sensor_msgs/Imu."""
    return float(np.frombuffer(imu.data, "<f8", 1, len(imu.data) - 24 - 72)[0])
