"""`hubodo play`: replay a log in real time, in a live view or on a pseudo serial port."""

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
from hubodo.ingest.replay.log_frames import (
    Quantisation,
    TimedFrame,
    raw_links,
    recorded_frames,
    synthesise_frames,
)
from hubodo.ingest.replay.pty_player import PtyPlayer
from hubodo.ingest.stop_signals import stop_on_signals
from hubodo.log.any_log import open_as_mcap
from hubodo.log.recording_reader import open_log, read_recording
from hubodo.log.roles import NODES_ROLE
from hubodo.vehicle import load_vehicle
from hubodo.verbs.log_options import LOG_HELP, add_log_options, stated_input_format
from hubodo.verbs.numbers import bounded_number, non_negative_number
from hubodo.verbs.play_view import OdometryReplay, replay_in_terminal
from hubodo.verbs.web_options import add_foxglove_argument

EXAMPLE = "hubodo play ride.mcap --speed 4\n  hubodo play ride.mcap --to pty --link /tmp/ttyRIDE"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo play`."""
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    add_log_options(parser)
    parser.add_argument(
        "--speed",
        type=non_negative_number,
        default=1.0,
        help="replay speed relative to real time; 0 = as fast as possible (default 1)",
    )
    parser.add_argument(
        "--start",
        type=bounded_number(),
        metavar="S",
        help="start at this time of the log, s, as shown by `hubodo info`",
    )
    parser.add_argument("--end", type=bounded_number(), metavar="S", help="end at this time of the log, s")
    parser.add_argument(
        "--to",
        choices=("view", "pty"),
        default="view",
        help="view (default), or pty: frames on a pseudo serial port (realistic timing only at speed 1)",
    )
    parser.add_argument(
        "--link", type=Path, metavar="PATH", help="with --to pty: symbolic link to create for the port"
    )
    parser.add_argument(
        "--only", metavar="LINK", help="with --to pty: only the frames of this link of the log"
    )
    parser.add_argument(
        "--vehicle",
        type=Path,
        metavar="TOML",
        help="with the view: vehicle file to use instead of that in the log",
    )
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="TOML",
        help="with the view: calibration to use instead of that in the log",
    )
    add_foxglove_argument(parser)


@dataclass(frozen=True)
class PlayResult:
    """The outcome of a replay.

    Attributes
    ----------
    file
        Path of the log.
    start, end
        Replayed span, s of the log.
    port
        Path of the pseudo serial port, or None for the view.
    n_frames
        Number of frames sent, or None for the view.
    n_unread
        Number of frames sent while no reader was connected.
    quantisation
        Rounding of nodes whose frames had to be encoded from samples.
    odometry
        The recomputed odometry; None without a vehicle, and for frames.
    """

    file: str
    start: float
    end: float
    port: str | None = None
    n_frames: int | None = None
    n_unread: int = 0
    quantisation: tuple[Quantisation, ...] = ()
    odometry: OdometryReplay | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return {
            "file": self.file,
            "start": self.start,
            "end": self.end,
            "port": self.port,
            "frames": self.n_frames,
            "unheard": self.n_unread,
            "quantisation": [
                {"node": q.node, "node_id": q.node_id, "gyro_step": q.gyro_step, "accel_step": q.accel_step}
                | {"time_error": q.time_error, "temperature": q.has_temperature}
                for q in self.quantisation
            ],
            "odometry": None if self.odometry is None else self.odometry.as_json(),
        }

    def render(self, console: Console) -> None:
        """Print the replayed span and the recomputed odometry."""
        frames = (
            "" if self.n_frames is None else f", {self.n_frames} frames, {self.n_unread} without a reader"
        )
        console.print(f"{self.file}: played {self.start:.2f} s to {self.end:.2f} s{frames}", highlight=False)
        odometry = self.odometry
        if odometry is not None:
            comparison = {
                True: ", identical to the recorded ones",
                False: ", DIFFERENT from the recorded ones",
                None: "",
            }[odometry.is_equal]
            console.print(
                f"odometry from {' and '.join(odometry.nodes) or 'no node'}: {odometry.n_poses} poses, "
                f"{odometry.n_located} of them on the map{comparison}",
                highlight=False,
            )


def run(args: argparse.Namespace) -> PlayResult:
    """Replay the log until its end, --end or ctrl-C.

    Returns
    -------
    PlayResult
        The replayed span, the frames sent or the recomputed odometry.

    Raises
    ------
    InputError
        If options contradict each other or the link does not exist.
    LogError
        If the file is no log that can be read.
    """
    if args.start is not None and args.end is not None and args.end <= args.start:
        raise InputError(f"--end {args.end} is not after --start {args.start}")
    if args.to == "view" and (args.link is not None or args.only is not None):
        raise InputError("--link and --only belong to --to pty; add it")
    if args.to == "pty" and (args.vehicle is not None or args.calibration is not None):
        raise InputError("--vehicle and --calibration belong to the view; remove --to pty")
    if args.to == "pty" and args.foxglove is not None:
        raise InputError("--foxglove belongs to the view; remove --to pty")
    vehicle = None if args.vehicle is None else load_vehicle(args.vehicle)
    form = stated_input_format(args, vehicle, needed=(NODES_ROLE,))
    play = _play_to_pty if args.to == "pty" else _play_to_view
    with stop_on_signals(threading.Event()) as stopping, open_as_mcap(args.log, form) as file:
        played = play(argparse.Namespace(**{**vars(args), "log": file, "named": args.log}), stopping.is_set)
    return replace(played, file=str(args.log))


def _play_to_pty(args: argparse.Namespace, stopped: Callable[[], bool]) -> PlayResult:
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
            frames, rounding = synthesise_frames(read_recording(args.log), args.start, args.end)
            quantisation = tuple(rounding)
            for q in rounding:
                _print_line(_quantisation_text(q))
        span = _ReplayedSpan()
        with PtyPlayer(args.link, args.speed) as player:
            _print_line(f"waiting for a reader: hubodo record {player.path} -o FILE.mcap")
            player.play(span.watch(frames), stopped, span.update)
            return PlayResult(
                str(args.log),
                span.first,
                span.last,
                player.path,
                player.frames,
                player.undelivered,
                quantisation,
            )


def _quantisation_text(q: Quantisation) -> str:
    temperature = "" if q.has_temperature else "; no temperature in the log: 25 degC is sent"
    return (
        f"{q.node} has no frames in the log; encoded as node {q.node_id} in steps of "
        f"{math.degrees(q.gyro_step):.2e} deg/s and {q.accel_step:.2e} m/s2, "
        f"times within {q.time_error * 1e6:.0f} us{temperature}"
    )


class _ReplayedSpan:
    """The first and the latest time replayed, s."""

    def __init__(self) -> None:
        self.first = self.last = 0.0
        self._started = False

    def watch(self, frames: Iterable[TimedFrame]) -> Iterator[TimedFrame]:
        for frame in frames:
            if not self._started:
                self.first, self._started = frame.t, True
            yield frame

    def update(self, t: float) -> None:
        self.last = t


def _play_to_view(args: argparse.Namespace, stopped: Callable[[], bool]) -> PlayResult:
    first, last, odometry = replay_in_terminal(args, _print_line, stopped)
    return PlayResult(str(args.log), first, last, odometry=odometry)


def _print_line(text: str) -> None:
    print(f"hubodo play: {text}", file=sys.stderr, flush=True)
