"""`hubodo play`: a log in its own time, to a live view or onto a pseudo serial port."""

from __future__ import annotations

import argparse
import math
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.live import Live
from rich.table import Table

from hubodo.errors import InputError
from hubodo.ingest.pty_player import PtyPlayer
from hubodo.ingest.replay import Quantisation, TimedFrame, made_frames, raw_links, recorded_frames
from hubodo.ingest.stopping import stop_on_signals
from hubodo.log.mcap import open_log, read_recording
from hubodo.log.recording import Recording

HELP = "play a log: a live view, or frames on a pseudo serial port that `hubodo record` can read"
EXAMPLE = "hubodo play ride.mcap --speed 4\n  hubodo play ride.mcap --to pty --link /tmp/ttyRIDE"

_REFRESH_S = 0.25
_LINE_S = 10.0
_RATE_WINDOW_S = 2.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The log, which part of it, how fast, and where to."""
    parser.add_argument("log", type=Path, metavar="FILE.mcap")
    parser.add_argument(
        "--speed", type=float, default=1.0, help="times real time; 0 = as fast as possible (default 1)"
    )
    parser.add_argument(
        "--start", type=float, metavar="S", help="from this time of the log, as `hubodo info` shows it"
    )
    parser.add_argument("--end", type=float, metavar="S", help="up to this time")
    parser.add_argument(
        "--to",
        choices=("view", "pty"),
        default="view",
        help="view (default), or pty: the frames on a pseudo serial port; its clock is right at speed 1 only",
    )
    parser.add_argument("--link", type=Path, metavar="PATH", help="with --to pty: a symlink to the port")
    parser.add_argument(
        "--only", metavar="LINK", help="with --to pty: the frames of this link of the log alone"
    )


@dataclass(frozen=True)
class PlayResult:
    """What was played.

    start, end: s of the log. frames: how many, None for the view; unheard: those played to nobody.
    """

    file: str
    start: float
    end: float
    port: str | None = None
    frames: int | None = None
    unheard: int = 0
    quantisation: tuple[Quantisation, ...] = ()

    def as_json(self) -> dict[str, Any]:
        return {
            "file": self.file,
            "start": self.start,
            "end": self.end,
            "port": self.port,
            "frames": self.frames,
            "unheard": self.unheard,
            "quantisation": [
                {"node": q.node, "node_id": q.node_id, "gyro_step": q.gyro_step, "accel_step": q.accel_step}
                | {"time_error": q.time_error, "temperature": q.temperature}
                for q in self.quantisation
            ],
        }

    def render(self, console: Console) -> None:
        frames = (
            "" if self.frames is None else f", {self.frames} frames, {self.unheard} while nobody listened"
        )
        console.print(f"{self.file}: played {self.start:.2f} s to {self.end:.2f} s{frames}", highlight=False)


def run(args: argparse.Namespace) -> PlayResult:
    """Plays until the end of the part, or ctrl-C.

    Raises InputError for a speed, part or link that makes no sense, LogError for what is no log.
    """
    if not (math.isfinite(args.speed) and args.speed >= 0):
        raise InputError(f"--speed {args.speed}: write a number from 0 on")
    if args.start is not None and args.end is not None and args.end <= args.start:
        raise InputError(f"--end {args.end} is not after --start {args.start}")
    if args.to == "view" and (args.link is not None or args.only is not None):
        raise InputError("--link and --only belong to --to pty; add it")
    with stop_on_signals(threading.Event()) as stopping:
        return _to_pty(args, stopping.is_set) if args.to == "pty" else _to_view(args, stopping.is_set)


def _to_pty(args: argparse.Namespace, stopped: Callable[[], bool]) -> PlayResult:
    quantisation: tuple[Quantisation, ...] = ()
    with open_log(args.log) as log:
        t_zero_ns = log.t_zero_ns or 0
        for _ in log.chunks():  # some writers announce channels inside the chunks only
            if log.streams:
                break
        links = raw_links(log)
        if args.only is not None and args.only not in links:
            raise InputError(
                f"{args.log}: no frames of link {args.only!r}; there are {', '.join(links) or 'none'}"
            )
        frames: Iterable[TimedFrame]
        if links:
            wanted = [args.only] if args.only is not None else links
            frames = recorded_frames(log, wanted, t_zero_ns, args.start, args.end)
        else:
            frames, made = made_frames(read_recording(args.log), args.start, args.end)
            quantisation = tuple(made)
            for q in made:
                _say(_quantisation_text(q))
        span = _Span()
        with PtyPlayer(args.link, args.speed) as player:
            _say(f"waiting for a reader: hubodo record {player.path} -o FILE.mcap")
            player.play(span.over(frames), stopped, span.tick)
            return PlayResult(
                str(args.log), span.first, span.last, player.path, player.frames, player.unheard, quantisation
            )


def _quantisation_text(q: Quantisation) -> str:
    temperature = "" if q.temperature else "; no temperature in the log: 25 degC is sent"
    return (
        f"{q.node} has no frames in the log; made as node {q.node_id} in steps of "
        f"{math.degrees(q.gyro_step):.2e} deg/s and {q.accel_step:.2e} m/s2, "
        f"times within {q.time_error * 1e6:.0f} us{temperature}"
    )


class _Span:
    """First and newest time played."""

    def __init__(self) -> None:
        self.first = self.last = 0.0
        self._begun = False

    def over(self, frames: Iterable[TimedFrame]) -> Iterator[TimedFrame]:
        for frame in frames:
            if not self._begun:
                self.first, self._begun = frame.t, True
            yield frame

    def tick(self, t: float) -> None:
        self.last = t


def _to_view(args: argparse.Namespace, stopped: Callable[[], bool]) -> PlayResult:
    recording = read_recording(args.log)
    tables = [table.t for table in recording.nodes.values() if len(table)]
    if not tables:
        raise InputError(f"{args.log}: holds no node; there is nothing to show")
    first = min(float(t[0]) for t in tables) if args.start is None else args.start
    last = max(float(t[-1]) for t in tables) if args.end is None else args.end
    if last < first:
        raise InputError(f"{args.log}: nothing between {first:g} s and {last:g} s; see `hubodo info`")
    console = Console(file=sys.stderr)
    began, now, next_line = time.monotonic(), first, first
    with Live(console=console, auto_refresh=False) if console.is_terminal else _no_live() as live:
        while not stopped() and now < last:
            elapsed = time.monotonic() - began
            now = last if not args.speed else min(last, first + elapsed * args.speed)
            if live is not None:
                live.update(_view(recording, now, last), refresh=True)
            elif now >= next_line:
                next_line = now + _LINE_S * max(args.speed, 1.0)
                _say(_line(recording, now))
            if now < last:
                time.sleep(min(_REFRESH_S, (last - now) / args.speed))
    return PlayResult(str(args.log), first, now)


def _view(recording: Recording, now: float, last: float) -> Table:
    table = Table(title=f"{now:.1f} of {last:.1f} s")
    for column in ("node", "Hz", "samples", "gx rad/s", "gy rad/s", "gz rad/s"):
        table.add_column(column, justify="left" if column == "node" else "right")
    for name, node in recording.nodes.items():
        seen = _before(node.t, now)
        rates = [f"{node[axis][seen - 1]:+.3f}" if seen else "-" for axis in ("gx", "gy", "gz")]
        table.add_row(name, f"{_rate(node.t, now):.1f}", str(seen), *rates)
    table.caption = _motion(recording, now)
    return table


def _line(recording: Recording, now: float) -> str:
    rates = ", ".join(f"{name} {_rate(node.t, now):.1f} Hz" for name, node in recording.nodes.items())
    return f"{now:.1f} s: {rates}; {_motion(recording, now)}"


def _motion(recording: Recording, now: float) -> str:
    odometry = recording.odometry
    if odometry is None:
        return "no odometry in this log; `hubodo fuse` makes one"
    seen = _before(odometry.t, now)
    if not seen:
        return "odometry has not begun"
    k = seen - 1
    return (
        f"speed {odometry['speed'][k]:+.2f} m/s, heading {math.degrees(odometry['heading'][k]):+.1f} deg, "
        f"x {odometry['x'][k]:.2f} m, y {odometry['y'][k]:.2f} m"
    )


def _before(t: NDArray[np.float64], now: float) -> int:
    return int(np.searchsorted(t, now, side="right"))


def _rate(t: NDArray[np.float64], now: float) -> float:
    """Samples a second over the last two seconds, or since the first sample."""
    seen = _before(t, now)
    if seen < 2:
        return 0.0
    window = min(_RATE_WINDOW_S, now - float(t[0])) or _RATE_WINDOW_S
    return (seen - _before(t, now - window)) / window


def _say(text: str) -> None:
    print(f"hubodo play: {text}", file=sys.stderr, flush=True)


@contextmanager
def _no_live() -> Iterator[None]:
    yield None
