"""Result of the fusion of a log: its report, as rows and JSON, and its files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hubodo.atomic_files import atomic_files
from hubodo.errors import InputError
from hubodo.fuse.track import Score, Track, format_error
from hubodo.log.csv_table import write_table
from hubodo.pages.console import print_table
from hubodo.recording import Table
from hubodo.safe_text import json_text

if TYPE_CHECKING:
    from rich.console import Console

TRACK_COLUMNS = (
    *("t", "x", "y", "heading", "speed", "sigma_x", "sigma_y", "sigma_heading"),
    *("cov_xy", "cov_x_heading", "cov_y_heading"),
)
RESULT_FILES = ("track.csv", "fuse.json")
_SUFFIXES_OF_FILES = (".csv", ".json", ".mcap", ".html", ".gpx", ".kml", ".tum", ".txt", ".toml")


@dataclass(frozen=True, eq=False)
class FusedRecording:
    """A recording fused into a track, with everything that fuse.json reports.

    Attributes
    ----------
    log : name of the log.
    track : the fused track.
    methods : names of the estimators, in the order in which they ran.
    lag : s by which the samples that the wheel filter used for a pose may be later than it; inf for the whole
        log.
    nodes : names of the nodes used.
    details : further entries of fuse.json, such as distance, estimated parameters and slips.
    calibration : file and SHA-256 of the calibration that was applied, None without one.
    score : error against truth, None where the log has no truth.
    warnings : one line each.
    output : folder of the results, None if they are not written.
    """

    log: str
    track: Track
    methods: tuple[str, ...]
    lag: float
    nodes: tuple[str, ...]
    details: Mapping[str, Any]
    calibration: Mapping[str, str] | None
    score: Score | None
    warnings: tuple[str, ...]
    output: str | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the content of fuse.json."""
        content: dict[str, Any] = {
            "log": self.log,
            **({} if self.output is None else {"output": self.output}),
            "methods": list(self.methods),
            "wheel_nodes": list(self.nodes),
            "smoothing": _describe_smoothing(self.lag),
            # The graph, too, uses the whole log for each pose.
            "causal": self.lag == 0.0 and len(self.methods) == 1,
            **self.details,
            "calibration": None if self.calibration is None else dict(self.calibration),
            "warnings": list(self.warnings),
        }
        if self.score is not None:
            content["truth"] = {
                name: value
                for name, value in asdict(self.score).items()
                if value is not None or name.endswith("_percent")
            }
        return content

    def summary_rows(self) -> list[tuple[str, str]]:
        """Return the result as rows (quantity, value) for a table."""
        track = self.track
        end = f"{track.x[-1]:.3f}, {track.y[-1]:.3f} m, {math.degrees(track.heading[-1]):.2f}°"
        sigma = f"{track.sigma_x[-1]:.3f}, {track.sigma_y[-1]:.3f} m"
        rows = [
            *(("method", method) for method in self.methods),
            ("duration", f"{track.t[-1] - track.t[0]:.2f} s"),
            ("distance", f"{self.details['distance']:.3f} m"),
            ("end", end),
            ("1σ at the end", f"{sigma}, {math.degrees(track.sigma_heading[-1]):.2f}°"),
        ]
        if self.score is not None:
            score = self.score
            rows += [
                ("final error", format_error(score.final_error, score.final_percent, " of path")),
                ("rms error", format_error(score.rms_error, score.rms_percent)),
                ("largest error", format_error(score.maximum_error, score.maximum_percent)),
            ]
            if score.rotation is not None and score.rotated_maximum_error is not None:
                rotated = format_error(score.rotated_maximum_error, score.rotated_maximum_percent)
                rows.append((f"rotated by {math.degrees(score.rotation):+.2f}°", f"{rotated} at most"))
            if score.heading_rms is not None:
                rows.append(("heading rms", f"{math.degrees(score.heading_rms):.2f}°"))
        return rows

    def render(self, console: Console) -> None:
        """Print the main results, then the warnings."""
        print_table(console, (), self.summary_rows(), f"{self.log} → {self.output}")
        for text in self.warnings:
            console.print(f"warning: {text}", highlight=False, markup=False, soft_wrap=True)


def _describe_smoothing(lag: float) -> dict[str, Any]:
    if lag == 0.0:
        return {"kind": "none"}
    return {"kind": "fixed lag", "lag": lag} if math.isfinite(lag) else {"kind": "full"}


def track_to_table(track: Track) -> Table:
    """Return a track as the table of track.csv."""
    return Table({name: getattr(track, name) for name in TRACK_COLUMNS})


def check_no_results(folder: Path) -> None:
    """Raise InputError for a folder that already holds a result, or for the name of a file."""
    if folder.suffix.lower() in _SUFFIXES_OF_FILES and not folder.is_dir():
        raise InputError(
            f"{folder}: is the name of a file, and a folder is due here, such as {folder.stem}/ with "
            f"{' and '.join(RESULT_FILES)} in it; `hubodo export` writes other formats of the track"
        )
    existing = next((folder / name for name in RESULT_FILES if (folder / name).exists()), None)
    if existing is not None:
        raise InputError(f"{existing}: exists already; choose another name, or give --force to replace it")


def write_results(fused: FusedRecording, folder: Path) -> FusedRecording:
    """Write track.csv and fuse.json atomically, and return the result with its folder.

    The folder is created where it is missing.
    """
    written = replace(fused, output=str(folder))
    with atomic_files(*(folder / name for name in RESULT_FILES), create_folder=True) as (track, report):
        write_table(track, track_to_table(fused.track))
        text = json_text(written.as_json(), indent=2)
        report.write_text(text + "\n", "utf-8")
    return written
