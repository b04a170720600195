"""Result of a heading measurement: track, standstills, noise, baselines and score, as JSON and as text."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hubodo.effects.warmup import WarmupModel
from hubodo.fuse.heading_filter import BiasNoise
from hubodo.html_table import html_lines, html_table
from hubodo.pages.console import print_lines, print_table
from hubodo.sensors.heading.page import describe_spans, score_rows, summarise_heading
from hubodo.sensors.heading.score import HeadingScore
from hubodo.sensors.heading.track import HeadingTrack

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class HeadingResult:
    """The heading of one gyro axis.

    Attributes
    ----------
    log, output : str, str or None
        Path of the log, and of the CSV file.
    node, axis : str
        Name of the node and of the axis.
    upwards : bool
        True if the axis points up.
    standstills : tuple
        (from, to) of each standstill, s.
    warmup, noise : WarmupModel, BiasNoise
        Warm-up model and bias noise of the axis.
    scale_sigma : float
        Relative sigma of the scale factor.
    lag : float
        Delay of the gyro, s.
    track : HeadingTrack
        Heading over time: `t`, `heading`, `sigma`, `bias` and `sigma_bias`, (N,) each, in s, rad and rad/s.
    score : HeadingScore or None
        Errors against the truth.
    notes : tuple of str
        Remarks.
    """

    log: str
    output: str | None
    node: str
    axis: str
    upwards: bool
    standstills: tuple[tuple[float, float], ...]
    warmup: WarmupModel
    noise: BiasNoise
    scale_sigma: float
    lag: float
    track: HeadingTrack
    score: HeadingScore | None
    notes: tuple[str, ...]

    @property
    def start(self) -> float:
        """Return the true heading at the first sample, rad, or 0 without truth."""
        return 0.0 if self.score is None else self.score.start

    @property
    def duration(self) -> float:
        """Return the duration, s."""
        return float(self.track.t[-1] - self.track.t[0])

    def final_headings(self) -> dict[str, float]:
        """Return the total turn by each estimate.

        Returns
        -------
        dict
            Turn in rad by name; `heading` is that of the filter, the others are simpler estimates.
        """
        turns = {"heading": float(self.track.heading[-1])}
        return turns | {name: float(values[-1]) for name, values in self.track.baselines.items()}

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result of `hubodo heading`.

        Returns
        -------
        dict
            The JSON object: rates in rad/s, times in s, angles in rad unless the key says degrees.
        """
        track, noise, model = self.track, self.noise, self.warmup
        warmup: dict[str, Any] = {"c1": model.c1, "time_constant": model.time_constant}
        if model.c1_second:
            warmup |= {"c1_second": model.c1_second, "time_constant_second": model.time_constant_second}
        warmup["sigma"] = dict(noise.warmup)
        return {
            "log": self.log,
            "output": self.output,
            "node": self.node,
            "axis": self.axis,
            "upwards": self.upwards,
            "duration": self.duration,
            "rests": [list(span) for span in self.standstills],
            "heading": float(track.heading[-1]) + self.start,
            "turned_deg": {name: math.degrees(end) for name, end in self.final_headings().items()},
            "sigma": float(track.sigma[-1]),
            "sigma_deg": math.degrees(float(track.sigma[-1])),
            "bias": {"value": float(track.bias[-1]), "sigma": float(track.sigma_bias[-1])},
            "noise": {"N": noise.angle_random_walk, "B": noise.bias_instability, "K": noise.rate_random_walk},
            "warmup": warmup if model.c1 else None,
            "scale_sigma": self.scale_sigma,
            "lag": self.lag,
            "gaps": [list(gap) for gap in track.gaps],
            "score": None if self.score is None else self._score_json(self.score),
            "notes": list(self.notes),
        }

    def render(self, console: Console) -> None:
        """Print the final heading, compared with simpler estimates and with the truth.

        Parameters
        ----------
        console : rich.console.Console
            The console to print to.
        """
        headings, *rows = score_rows(self)
        print_lines(console, [summarise_heading(self)])
        print_table(console, headings, rows, f"{self.node} {self.axis}")
        print_lines(console, [f"standstills: {describe_spans(self.standstills)}"])
        print_lines(console, self.notes, label="note")
        if self.output:
            print_lines(console, [f"written to {self.output}"])

    def __repr__(self) -> str:
        turned, sigma = math.degrees(self.track.heading[-1]), math.degrees(self.track.sigma[-1])
        return f"HeadingResult({self.node} {self.axis}: turned by {turned:+.2f}° ± {sigma:.2f}°)"

    def _repr_html_(self) -> str:
        headings, *rows = score_rows(self)
        return html_lines((summarise_heading(self),)) + html_table(headings, rows) + html_lines(self.notes)

    def _score_json(self, score: HeadingScore) -> dict[str, Any]:
        result: dict[str, Any] = {"against": score.source, "end_in_sigma": score.final_error_in_sigma}
        for name, error in score.errors.items():
            result[name] = {
                "rms_deg": math.degrees(error.rms),
                "end_deg": math.degrees(error.final),
                "worst_deg": math.degrees(error.largest),
            }
        return result
