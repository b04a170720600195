"""The live view of `hubodo play`: a log's nodes and its odometry, made again, as time goes on."""

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
from hubodo.ingest.live.localizer import Located
from hubodo.ingest.live.odometer import OdometryRows
from hubodo.ingest.replay.playback import Playback, as_messages, recorded_messages
from hubodo.log import topics
from hubodo.log.recording_reader import open_log, read_recording
from hubodo.recording import Recording
from hubodo.terminal import SafeConsole
from hubodo.vehicle import load_vehicle

_REFRESH_S = 0.25
_FOXGLOVE_S = 0.02
_LINE_S = 10.0
_RATE_WINDOW_S = 2.0


@dataclass(frozen=True)
class Replayed:
    """The odometry made again, and of them `located` on the map.

    equal: whether every row is, to the last bit, the one recorded; None where another vehicle or calibration
    was given, or the log has no odometry.
    """

    nodes: tuple[str, ...]
    poses: int
    located: int
    recorded: int | None
    equal: bool | None

    def as_json(self) -> dict[str, Any]:
        return {
            "nodes": list(self.nodes),
            "poses": self.poses,
            "located": self.located,
            "recorded": self.recorded,
            "equal": self.equal,
        }


def show(
    args: argparse.Namespace, say: Callable[[str], None], stopped: Callable[[], bool]
) -> tuple[float, float, Replayed | None]:
    """Shows the log; the part that was shown, s, and what became of its odometry."""
    recording = read_recording(args.log)
    for line in recording.warnings:
        say(f"warning: {line}")
    tables = [table.t for table in recording.nodes.values() if len(table)]
    if not tables:
        raise InputError(f"{args.named}: holds no node; there is nothing to show")
    first = min(float(t[0]) for t in tables) if args.start is None else args.start
    last = max(float(t[-1]) for t in tables) if args.end is None else args.end
    if last < first:
        raise InputError(f"{args.named}: nothing between {first:g} s and {last:g} s; see `hubodo info`")
    again = _Again(args)
    console = SafeConsole(file=sys.stderr)
    began, now, next_line = time.monotonic(), first, first
    with (
        Live(console=console, auto_refresh=False) if console.is_terminal else _no_live() as live,
        _foxglove(args, first, say) as show_to,
    ):
        while not stopped() and now < last:
            elapsed = time.monotonic() - began
            now = last if not args.speed else min(last, first + elapsed * args.speed)
            again.up_to(now)
            show_to(now)
            if live is not None:
                live.update(_view(recording, again, now, last), refresh=True)
            elif now >= next_line:
                next_line = now + _LINE_S * max(args.speed, 1.0)
                say(_line(recording, again, now))
            if now < last:
                pause = _REFRESH_S if args.foxglove is None else _FOXGLOVE_S
                time.sleep(min(pause, (last - now) / args.speed))
    for line in again.warnings():
        say(f"odometry: {line}")
    return first, now, again.result(recording, whole=args.end is None and now >= last)


class _Again:
    """The odometry of the log through the object of a live run, as far as the view has come."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._given = args.vehicle is not None or args.calibration is not None
        self._path = args.log
        vehicle = None if args.vehicle is None else load_vehicle(args.vehicle)
        calibration = None if args.calibration is None else read_calibration(args.calibration)
        self._playback = Playback(args.log, vehicle=vehicle, calibration=calibration)
        self._coming: Iterator[OdometryRows | Located] = self._playback.publications()
        self._next: OdometryRows | Located | None = next(self._coming, None)
        self._done: list[OdometryRows | Located] = []

    @property
    def possible(self) -> bool:
        """Whether the vehicle is known."""
        return self._playback.odometer is not None

    def up_to(self, now: float) -> None:
        """Takes what came until `now`, s."""
        limit = self._playback.t_zero_ns + round(now * 1e9)
        while self._next is not None and int(self._next.t_ns[0]) <= limit:
            self._done.append(self._next)
            self._next = next(self._coming, None)

    def words(self) -> str:
        """Where the vehicle is."""
        if not self._done:
            return "odometry has not begun"
        last = next(made for made in reversed(self._done) if isinstance(made, OdometryRows))
        return _words(*(float(v[-1]) for v in (last.speed, last.heading, *last.position.T)))

    def warnings(self) -> list[str]:
        """What the odometry has to say at the end."""
        odometer = self._playback.odometer
        return odometer.warnings(end=True) if odometer is not None and self._next is None else []

    def result(self, recording: Recording, *, whole: bool) -> Replayed | None:
        """What was made, compared with what was recorded when the whole log was played."""
        odometer = self._playback.odometer
        if odometer is None:
            return None
        recorded = None if recording.odometry is None else len(recording.odometry)
        equal = None
        if whole and recorded is not None and not self._given:
            equal = self._equal()
        located = sum(isinstance(made, Located) for made in self._done)
        poses = sum(len(made.t_ns) for made in self._done) - located
        return Replayed(odometer.nodes, poses, located, recorded, equal)

    def _equal(self) -> bool:
        kept, done = recorded_messages(self._path), self._done
        if not kept[topics.ODOM_MAP]:
            # Where it was recorded nothing was made of the fixes.
            kept = recorded_messages(self._path, on_map=False)
            done = [made for made in done if isinstance(made, OdometryRows)]
        return as_messages(done, self._playback.t_zero_ns) == kept


def _view(recording: Recording, again: _Again, now: float, last: float) -> Table:
    table = Table(title=f"{now:.1f} of {last:.1f} s")
    for column in ("node", "Hz", "samples", "gx rad/s", "gy rad/s", "gz rad/s"):
        table.add_column(column, justify="left" if column == "node" else "right")
    for name, node in recording.nodes.items():
        seen = _before(node.t, now)
        rates = [f"{node[axis][seen - 1]:+.3f}" if seen else "-" for axis in ("gx", "gy", "gz")]
        table.add_row(name, f"{_rate(node.t, now):.1f}", str(seen), *rates)
    table.caption = _motion(recording, again, now)
    return table


def _line(recording: Recording, again: _Again, now: float) -> str:
    rates = ", ".join(f"{name} {_rate(node.t, now):.1f} Hz" for name, node in recording.nodes.items())
    return f"{now:.1f} s: {rates}; {_motion(recording, again, now)}"


def _motion(recording: Recording, again: _Again, now: float) -> str:
    if again.possible:
        return again.words()
    odometry = recording.odometry
    if odometry is None:
        return "no odometry in this log: give --vehicle, or see `hubodo fuse`"
    seen = _before(odometry.t, now)
    if not seen:
        return "odometry has not begun"
    return _words(*(float(odometry[name][seen - 1]) for name in ("speed", "heading", "x", "y")))


def _words(speed: float, heading: float, x: float, y: float) -> str:
    return f"speed {speed:+.2f} m/s, heading {math.degrees(heading):+.1f} deg, x {x:.2f} m, y {y:.2f} m"


def _before(t: NDArray[np.float64], now: float) -> int:
    return int(np.searchsorted(t, now, side="right"))


def _rate(t: NDArray[np.float64], now: float) -> float:
    """Samples a second over the last two seconds, or since the first sample."""
    seen = _before(t, now)
    if seen < 2:
        return 0.0
    window = min(_RATE_WINDOW_S, now - float(t[0])) or _RATE_WINDOW_S
    return (seen - _before(t, now - window)) / window


@contextmanager
def _no_live() -> Iterator[None]:
    yield None


@contextmanager
def _foxglove(
    args: argparse.Namespace, first: float, say: Callable[[str], None]
) -> Iterator[Callable[[float], None]]:
    """Gives what sends the messages up to a time, s, to Foxglove; nothing where that was not asked for."""
    if args.foxglove is None:
        yield lambda now: None
        return
    from hubodo.web.address import parse_address
    from hubodo.web.config import FOXGLOVE_PORT
    from hubodo.web.foxglove_live import FoxgloveClients, FoxgloveLog

    address = parse_address(args.foxglove, FOXGLOVE_PORT)
    clients = FoxgloveClients(address)
    say(f"Foxglove: open connection ws://{replace(address, port=clients.port)}")
    try:
        with open_log(args.log) as log:
            zero_ns = log.t_zero_ns or 0
            played = FoxgloveLog(clients, log, zero_ns + round(first * 1e9))
            yield lambda now: played.up_to(zero_ns + round(now * 1e9))
    finally:
        clients.finish()
