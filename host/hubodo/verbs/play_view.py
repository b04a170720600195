"""The live view of `hubodo play`: the nodes of a log and its recomputed odometry over time."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.live import Live
from rich.table import Table

from hubodo.calibration.file import read_calibration
from hubodo.errors import InputError
from hubodo.ingest.live.localizer import MapPose
from hubodo.ingest.live.odometry_rows import OdometryRows
from hubodo.ingest.replay.playback import Playback, recorded_messages, to_messages
from hubodo.log import topics
from hubodo.log.recording_reader import open_log, read_recording
from hubodo.recording import Recording
from hubodo.terminal import SafeConsole
from hubodo.vehicle import load_vehicle

_REFRESH_PERIOD_S = 0.25
_FOXGLOVE_PERIOD_S = 0.02
_LINE_PERIOD_S = 10.0
_RATE_WINDOW_S = 2.0


@dataclass(frozen=True)
class OdometryReplay:
    """The odometry recomputed from a log.

    Attributes
    ----------
    nodes
        Wheel nodes that it uses.
    n_poses
        Number of poses.
    n_located
        Number of poses on the map.
    n_recorded
        Number of poses in the log, or None.
    is_equal
        True if every pose is identical to the recorded one, to the last bit; None if another vehicle or
        calibration was given, or the log has no odometry.
    """

    nodes: tuple[str, ...]
    n_poses: int
    n_located: int
    n_recorded: int | None
    is_equal: bool | None

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return {
            "nodes": list(self.nodes),
            "poses": self.n_poses,
            "located": self.n_located,
            "recorded": self.n_recorded,
            "equal": self.is_equal,
        }


def replay_in_terminal(
    args: argparse.Namespace, print_line: Callable[[str], None], stopped: Callable[[], bool]
) -> tuple[float, float, OdometryReplay | None]:
    """Replay the log in the terminal; return the span shown, s, and the recomputed odometry."""
    recording = read_recording(args.log)
    for line in recording.warnings:
        print_line(f"warning: {line}")
    tables = [table.t for table in recording.nodes.values() if len(table)]
    if not tables:
        raise InputError(f"{args.named}: holds no node; there is nothing to show")
    first = min(float(t[0]) for t in tables) if args.start is None else args.start
    last = max(float(t[-1]) for t in tables) if args.end is None else args.end
    if last < first:
        raise InputError(f"{args.named}: nothing between {first:g} s and {last:g} s; see `hubodo info`")
    replay = _OdometryReplayer(args)
    console = SafeConsole(file=sys.stderr)
    started, now, next_line = time.monotonic(), first, first
    with (
        Live(console=console, auto_refresh=False) if console.is_terminal else _no_live() as live,
        _foxglove(args, first, print_line) as publish_to,
    ):
        while not stopped() and now < last:
            elapsed = time.monotonic() - started
            now = last if not args.speed else min(last, first + elapsed * args.speed)
            replay.advance_to(now)
            publish_to(now)
            if live is not None:
                live.update(_view(recording, replay, now, last), refresh=True)
            elif now >= next_line:
                next_line = now + _LINE_PERIOD_S * max(args.speed, 1.0)
                print_line(_line(recording, replay, now))
            if now < last:
                pause = _REFRESH_PERIOD_S if args.foxglove is None else _FOXGLOVE_PERIOD_S
                time.sleep(min(pause, (last - now) / args.speed))
    for line in replay.warnings():
        print_line(f"odometry: {line}")
    return first, now, replay.result(recording, is_complete=args.end is None and now >= last)


class _OdometryReplayer:
    """The odometry of a log, recomputed by the live odometer up to the time shown."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._has_overrides = args.vehicle is not None or args.calibration is not None
        self._path = args.log
        vehicle = None if args.vehicle is None else load_vehicle(args.vehicle)
        calibration = None if args.calibration is None else read_calibration(args.calibration)
        self._playback = Playback(args.log, vehicle=vehicle, calibration=calibration)
        self._pending: Iterator[OdometryRows | MapPose] = self._playback.publications()
        self._next: OdometryRows | MapPose | None = next(self._pending, None)
        self._done: list[OdometryRows | MapPose] = []

    @property
    def is_available(self) -> bool:
        """Return True if the vehicle is known, so that odometry can be computed."""
        return self._playback.odometer is not None

    def advance_to(self, now: float) -> None:
        """Compute the odometry up to `now`, s of the log."""
        limit = self._playback.t_zero_ns + round(now * 1e9)
        while self._next is not None and int(self._next.t_ns[0]) <= limit:
            self._done.append(self._next)
            self._next = next(self._pending, None)

    def motion_text(self) -> str:
        """Return speed, heading and position as text."""
        if not self._done:
            return "odometry has not started yet"
        last = next(rows for rows in reversed(self._done) if isinstance(rows, OdometryRows))
        return _motion_text(*(float(v[-1]) for v in (last.speed, last.heading, *last.position.T)))

    def warnings(self) -> list[str]:
        """Return the warnings of the odometry at the end of the log."""
        odometer = self._playback.odometer
        return odometer.warnings(end=True) if odometer is not None and self._next is None else []

    def result(self, recording: Recording, *, is_complete: bool) -> OdometryReplay | None:
        """Return the recomputed odometry, compared with the recorded one if the whole log was replayed."""
        odometer = self._playback.odometer
        if odometer is None:
            return None
        recorded = None if recording.odometry is None else len(recording.odometry)
        equal = None
        if is_complete and recorded is not None and not self._has_overrides:
            equal = self._is_equal_to_recorded()
        located = sum(isinstance(rows, MapPose) for rows in self._done)
        poses = sum(len(rows.t_ns) for rows in self._done) - located
        return OdometryReplay(odometer.nodes, poses, located, recorded, equal)

    def _is_equal_to_recorded(self) -> bool:
        recorded, done = recorded_messages(self._path), self._done
        if not recorded[topics.ODOM_MAP]:
            # The recorder did not use the fixes: compare without the map.
            recorded = recorded_messages(self._path, include_map=False)
            done = [rows for rows in done if isinstance(rows, OdometryRows)]
        return to_messages(done, self._playback.t_zero_ns) == recorded


def _view(recording: Recording, replay: _OdometryReplayer, now: float, last: float) -> Table:
    table = Table(title=f"{now:.1f} of {last:.1f} s")
    for column in ("node", "Hz", "samples", "gx rad/s", "gy rad/s", "gz rad/s"):
        table.add_column(column, justify="left" if column == "node" else "right")
    for name, node in recording.nodes.items():
        count = _count_until(node.t, now)
        rates = [f"{node[axis][count - 1]:+.3f}" if count else "-" for axis in ("gx", "gy", "gz")]
        table.add_row(name, f"{_rate(node.t, now):.1f}", str(count), *rates)
    table.caption = _motion(recording, replay, now)
    return table


def _line(recording: Recording, replay: _OdometryReplayer, now: float) -> str:
    rates = ", ".join(f"{name} {_rate(node.t, now):.1f} Hz" for name, node in recording.nodes.items())
    return f"{now:.1f} s: {rates}; {_motion(recording, replay, now)}"


def _motion(recording: Recording, replay: _OdometryReplayer, now: float) -> str:
    if replay.is_available:
        return replay.motion_text()
    odometry = recording.odometry
    if odometry is None:
        return "no odometry in this log: give --vehicle, or see `hubodo fuse`"
    count = _count_until(odometry.t, now)
    if not count:
        return "odometry has not started yet"
    return _motion_text(*(float(odometry[name][count - 1]) for name in ("speed", "heading", "x", "y")))


def _motion_text(speed: float, heading: float, x: float, y: float) -> str:
    return f"speed {speed:+.2f} m/s, heading {math.degrees(heading):+.1f} deg, x {x:.2f} m, y {y:.2f} m"


def _count_until(t: NDArray[np.float64], now: float) -> int:
    return int(np.searchsorted(t, now, side="right"))


def _rate(t: NDArray[np.float64], now: float) -> float:
    """Return samples per second over the last two seconds, or since the first sample."""
    count = _count_until(t, now)
    if count < 2:
        return 0.0
    window = min(_RATE_WINDOW_S, now - float(t[0])) or _RATE_WINDOW_S
    return (count - _count_until(t, now - window)) / window


@contextmanager
def _no_live() -> Iterator[None]:
    yield None


@contextmanager
def _foxglove(
    args: argparse.Namespace, first: float, print_line: Callable[[str], None]
) -> Iterator[Callable[[float], None]]:
    """Yield a function that sends messages up to a time (s) to Foxglove, if --foxglove is given."""
    if args.foxglove is None:
        yield lambda now: None
        return
    from hubodo.web.address import parse_address
    from hubodo.web.config import FOXGLOVE_PORT
    from hubodo.web.foxglove_live import FoxgloveClients, FoxgloveReplay

    address = parse_address(args.foxglove, FOXGLOVE_PORT)
    clients = FoxgloveClients(address)
    print_line(f"Foxglove: open connection ws://{replace(address, port=clients.port)}")
    try:
        with open_log(args.log) as log:
            zero_ns = log.t_zero_ns or 0
            replayer = FoxgloveReplay(clients, log, zero_ns + round(first * 1e9))
            yield lambda now: replayer.send_until(zero_ns + round(now * 1e9))
    finally:
        clients.finish()
