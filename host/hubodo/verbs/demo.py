"""`hubodo demo`: the main job end to end, without hardware, on two virtual nodes."""

import argparse
import dataclasses
import math
import os
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table as TextTable

from hubodo.atomic_files import write_atomically
from hubodo.demo.page import demo_page, facts_grid
from hubodo.demo.scenario import VEHICLE_TOML, WHEEL_RADIUS, make_scenario
from hubodo.demo.sigma_check import check_sigmas
from hubodo.demo.simulated_drive import (
    INTERPRETERS,
    SimulatedDrive,
    add_board_arguments,
    choose_interpreter,
    record_drive,
)
from hubodo.emulator.interpreters.interpreter import InterpreterKind
from hubodo.emulator.interpreters.rp2040.pico import PicoSettings
from hubodo.errors import HubodoError
from hubodo.fuse.fusion import score_against_truth
from hubodo.fuse.track import Score, format_error
from hubodo.fuse.wheel_odometry import WheelOdometry, compute_wheel_odometry
from hubodo.log.recording_reader import read_recording
from hubodo.log.summary import Summary, summarise
from hubodo.pages.page import PageTable
from hubodo.recording import Recording, Table
from hubodo.report.log_page import log_page
from hubodo.safe_text import json_text
from hubodo.terminal import SafeConsole
from hubodo.vehicle import load_vehicle
from hubodo.verbs.numbers import bounded_number, seed

_DEMO_START_NS = 1_767_225_600_000_000_000
"""Start of the simulated clock, 2026-01-01 UTC: with the seed it makes each demo identical, bit by bit."""

EXAMPLE = "hubodo demo -o out/demo --seed 7"


@dataclass(frozen=True)
class DemoResult:
    """The result of a demo, compared with its simulated truth.

    Attributes
    ----------
    seed
        Seed of the drive, the sensors and the noise.
    interpreter
        The interpreter that ran the firmware.
    page, report
        Paths of the demo's page and of the log's report.
    ride
        The simulated drive and its log.
    warnings
        Warnings about the log, one line each.
    fused
        The track estimated from both wheels.
    score
        Errors of the track against the truth.
    true_length
        Length of the true path, m.
    seconds
        Duration of the demo on this computer, s.
    """

    seed: int
    interpreter: InterpreterKind
    page: Path
    report: Path
    ride: SimulatedDrive
    warnings: tuple[str, ...]
    fused: WheelOdometry
    score: Score
    true_length: float
    seconds: float

    def headline_figures(self) -> dict[str, str]:
        """Return the main results as label and text, for the terminal and the page."""
        score = self.score
        return {
            "firmware ran on": INTERPRETERS[self.interpreter],
            "length of the path": f"{self.fused.details['distance']:.2f} m (truth {self.true_length:.2f} m)",
            "final error": format_error(score.final_error, score.final_percent, " of the path"),
            "largest error": format_error(score.maximum_error, score.maximum_percent),
            "heading error, rms": "-"
            if score.heading_rms is None
            else f"{math.degrees(score.heading_rms):.2f}°",
            "seed": str(self.seed),
        }

    def link_table(self) -> PageTable:
        """Return one row for each node: rates, losses, clock."""
        rows = []
        for name, node in self.ride.recorded["nodes"].items():
            clock, link = node["clock"], self.ride.recorded["links"][node["link"]]
            rows.append(
                (
                    name,
                    f"{node['rate_hz']:.2f}",
                    str(node["samples"]),
                    str(node["samples_lost"]),
                    str(link["frames_damaged"]),
                    f"{round(clock['drift_ppm']) or 0:+d} ± {max(clock['drift_sigma_ppm'], 1.0):.0f}",
                    f"{clock['sigma'] * 1e3:.2f}",
                )
            )
        headings = (
            "node",
            "rate, Hz",
            "samples",
            "lost",
            "damaged frames",
            "clock drift, ppm",
            "clock 1σ, ms",
        )
        return PageTable(headings, rows)

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return {
            "seed": self.seed,
            "interpreter": self.interpreter,
            "page": str(self.page),
            "report": str(self.report),
            "log": str(self.ride.log),
            "true_length": self.true_length,
            "seconds": round(self.seconds, 1),
            "warnings": list(self.warnings),
            "recorded": self.ride.recorded,
            "fused": {
                "method": self.fused.method,
                **self.fused.details,
                "truth": dataclasses.asdict(self.score),
            },
        }

    def render(self, console: Console) -> None:
        """Print the links, the errors against the truth and the paths of the files."""
        links = self.link_table()
        table = TextTable(*links.headings, title="two virtual nodes")
        for row in links.rows:
            table.add_row(*row)
        console.print(table)
        facts = TextTable(title="the path, against the simulated truth", show_header=False)
        for key, value in self.headline_figures().items():
            facts.add_row(key, value)
        console.print(facts)
        for line in self.warnings:
            console.print(f"warning: {line}", highlight=False, markup=False, soft_wrap=True, style="yellow")
        for name, path in (("page", self.page), ("report", self.report), ("log", self.ride.log)):
            console.print(f"{name + ':':8}{path}", highlight=False, markup=False, soft_wrap=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo demo`."""
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("out/demo"),
        help="folder for the results (default: out/demo)",
    )
    parser.add_argument(
        "--seed", type=seed, default=1, help="seed of the drive, the sensors and the noise (default: 1)"
    )
    parser.add_argument(
        "--moving",
        type=bounded_number(5.0, 3600.0),
        default=60.0,
        help="duration of the drive between two standstills, s (default: 60)",
    )
    add_board_arguments(parser, "")


def run(args: argparse.Namespace) -> DemoResult:
    """Simulate, record and fuse a drive of two virtual nodes; write page, report and demo.json.

    Returns
    -------
    DemoResult
        The track, its errors against the truth and the paths of the files.

    Raises
    ------
    HubodoError
        If a virtual node or the recorder fails, or the error exceeds its own sigma by far.
    """
    started = time.monotonic()
    interpreter = choose_interpreter(args.interpreter, args.image, args.bootrom)
    out = _create_numbered_folder(args.output)
    scenario = make_scenario(args.seed, args.moving)
    note = SafeConsole(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=note, disable=not note.is_terminal, transient=True) as progress:
        task = progress.add_task("two virtual nodes drive", total=1.0)
        result = record_drive(
            scenario.simulated_nodes(),
            VEHICLE_TOML,
            out,
            interpreter,
            args.seed,
            lambda share: progress.update(task, completed=share),
            pico=PicoSettings(args.image, args.bootrom),
            start_ns=_DEMO_START_NS,
        )
    recording = read_recording(result.log)
    truth = scenario.truth((result.start_ns - recording.t_zero_ns) * 1e-9)
    recording = dataclasses.replace(recording, truth=truth)
    fused = compute_wheel_odometry(recording, load_vehicle(result.vehicle), log=str(result.log))
    score = score_against_truth(fused.track, recording)
    if score is None:
        raise HubodoError(f"{result.log}: the drive and its log do not overlap in time; run the demo again")
    check_sigmas(fused.track, truth, str(result.log))
    summary = summarise(result.log)
    demo = DemoResult(
        args.seed,
        interpreter,
        out / "index.html",
        out / "report.html",
        result,
        _log_warnings(summary),
        fused,
        score,
        scenario.path_length(),
        time.monotonic() - started,
    )
    _write_pages(demo, out, recording, truth, summary)
    return demo


def _write_pages(demo: DemoResult, out: Path, recording: Recording, truth: Table, summary: Summary) -> None:
    """Write the demo's page, the report of its log, and demo.json."""
    lead = (
        f"{demo.true_length:.0f} m, driven by two virtual wheel nodes running the real firmware; "
        f"the final error of the fused track is "
        f"{format_error(demo.score.final_error, demo.score.final_percent, ' of the path')}."
    )
    facts = facts_grid(demo.headline_figures())
    write_atomically(
        demo.page, demo_page(lead, facts, demo.fused.track, truth, recording, demo.link_table(), WHEEL_RADIUS)
    )
    report = log_page(demo.ride.log.name, recording, summary, vehicle=load_vehicle(demo.ride.vehicle))
    write_atomically(demo.report, report.html)
    write_atomically(out / "demo.json", _reproducible_json(demo, out))


def _log_warnings(summary: Summary) -> tuple[str, ...]:
    """Return the warnings of `hubodo info`, with the missing samples by topic and cause."""
    missing = Counter[tuple[str, str]]()
    for gap in summary.gaps:
        missing[gap.topic, gap.cause] += gap.missing
    gaps = (f"{topic}: {count} samples missing: {cause}" for (topic, cause), count in missing.items())
    return (*summary.warnings, *gaps)


def _reproducible_json(demo: DemoResult, out: Path) -> str:
    """Return the JSON result without folder and duration, so that it is identical for equal seeds."""
    stored = {key: value for key, value in demo.as_json().items() if key != "seconds"}
    return json_text(stored, indent=2).replace(f"{out}{os.sep}", "") + "\n"


def _create_numbered_folder(folder: Path) -> Path:
    """Create and return a new numbered subfolder, so that no earlier demo is overwritten."""
    number = 1
    while (folder / f"{number}").exists():
        number += 1
    new = (folder / f"{number}").resolve()
    new.mkdir(parents=True)
    return new
