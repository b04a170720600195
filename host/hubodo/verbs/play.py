"""`hubodo play`: a log in its own time, to a live view or onto a pseudo serial port."""

from __future__ import annotations

import argparse
import math
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.errors import InputError
from hubodo.ingest.replay.pty_player import PtyPlayer
from hubodo.ingest.replay.replay import Quantisation, TimedFrame, made_frames, raw_links, recorded_frames
from hubodo.ingest.stopping import stop_on_signals
from hubodo.log.any_log import open_as_mcap
from hubodo.log.recording_reader import open_log, read_recording
from hubodo.log.roles import NODES_ROLE
from hubodo.vehicle import load_vehicle
from hubodo.verbs.log_options import LOG_HELP, add_log_options, log_form
from hubodo.verbs.numbers import not_negative, number
from hubodo.verbs.play_view import Replayed, show
from hubodo.verbs.web_options import add_foxglove_argument

EXAMPLE = "hubodo play ride.mcap --speed 4\n  hubodo play ride.mcap --to pty --link /tmp/ttyRIDE"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The log, which part of it, how fast, and where to."""
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    add_log_options(parser)
    parser.add_argument(
        "--speed", type=not_negative, default=1.0, help="times real time; 0 = as fast as possible (default 1)"
    )
    parser.add_argument(
        "--start", type=number(), metavar="S", help="from this time of the log, as `hubodo info` shows it"
    )
    parser.add_argument("--end", type=number(), metavar="S", help="up to this time")
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
    parser.add_argument(
        "--vehicle", type=Path, metavar="TOML", help="with the view: geometry instead of that in the log"
    )
    parser.add_argument(
        "--calibration", type=Path, metavar="TOML", help="with the view: instead of that in the log"
    )
    add_foxglove_argument(parser)


@dataclass(frozen=True)
class PlayResult:
    """What was played.

    start, end: s of the log. frames: how many, None for the view; unheard: those played to nobody.
    odometry: None where the log has no vehicle, and in frames.
    """

    file: str
    start: float
    end: float
    port: str | None = None
    frames: int | None = None
    unheard: int = 0
    quantisation: tuple[Quantisation, ...] = ()
    odometry: Replayed | None = None

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
            "odometry": None if self.odometry is None else self.odometry.as_json(),
        }

    def render(self, console: Console) -> None:
        frames = (
            "" if self.frames is None else f", {self.frames} frames, {self.unheard} while nobody listened"
        )
        console.print(f"{self.file}: played {self.start:.2f} s to {self.end:.2f} s{frames}", highlight=False)
        made = self.odometry
        if made is not None:
            words = {True: ", every bit as recorded", False: ", NOT as recorded", None: ""}[made.equal]
            console.print(
                f"odometry from {' and '.join(made.nodes) or 'no node'}: {made.poses} poses, "
                f"{made.located} of them on the map{words}",
                highlight=False,
            )


def run(args: argparse.Namespace) -> PlayResult:
    """Plays until the end of the part, or ctrl-C.

    Raises InputError for a speed, part or link that makes no sense, LogError for what is no log.
    """
    if args.start is not None and args.end is not None and args.end <= args.start:
        raise InputError(f"--end {args.end} is not after --start {args.start}")
    if args.to == "view" and (args.link is not None or args.only is not None):
        raise InputError("--link and --only belong to --to pty; add it")
    if args.to == "pty" and (args.vehicle is not None or args.calibration is not None):
        raise InputError("--vehicle and --calibration belong to the view; leave --to pty away")
    if args.to == "pty" and args.foxglove is not None:
        raise InputError("--foxglove belongs to the view; leave --to pty away")
    vehicle = None if args.vehicle is None else load_vehicle(args.vehicle)
    form = log_form(args, vehicle, needed=(NODES_ROLE,))
    play = _to_pty if args.to == "pty" else _to_view
    with stop_on_signals(threading.Event()) as stopping, open_as_mcap(args.log, form) as file:
        played = play(argparse.Namespace(**{**vars(args), "log": file, "named": args.log}), stopping.is_set)
    return replace(played, file=str(args.log))


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
                f"{args.named}: no frames of link {args.only!r}; there are {', '.join(links) or 'none'}"
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
    first, last, odometry = show(args, _say, stopped)
    return PlayResult(str(args.log), first, last, odometry=odometry)


def _say(text: str) -> None:
    print(f"hubodo play: {text}", file=sys.stderr, flush=True)
