"""A fused track as Python programs use it: arrays, a data frame, a map, the files of `hubodo fuse`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hubodo.api.given import StrPath
from hubodo.api.plot import Plot
from hubodo.fuse.fusion import FusedRecording, check_no_results, track_to_table, write_results
from hubodo.fuse.track import Score, Track
from hubodo.html_table import html_lines, html_table
from hubodo.recording import Table
from hubodo.report.curves import Curve, curves_figure
from hubodo.report.page import COLOURS

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class FusedTrack(Track):
    """Where the vehicle went: arrays of one length, one entry for each pose.

    Attributes:
        t: s on the log's clock.
        x: m from the start; east where the log has positions on Earth.
        y: m from the start; north where the log has positions on Earth.
        heading: rad, anticlockwise from x and unwrapped.
        speed: m/s.
        sigma_x: m, 1 sigma; it grows from zero at the start.
        sigma_y: m, 1 sigma.
        sigma_heading: rad, 1 sigma.
        yaw_rate: rad/s; empty where GNSS or headings took part.
        step_inflation: m², of each step beyond what rolling wheels leave open; empty as `yaw_rate`.
        fused: how it was made: `methods`, `nodes`, `learnt`, `warnings`.
        truth: the table of that name in the log, or None.
    """

    fused: FusedRecording = field(kw_only=True)
    truth: Table | None = field(default=None, kw_only=True)

    @property
    def score(self) -> Score | None:
        """How far it is from the truth: m, %, rad; None where the log has no truth."""
        return self.fused.score

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line each."""
        return self.fused.warnings

    def as_json(self) -> dict[str, Any]:
        """What fuse.json holds."""
        return self.fused.as_json()

    def frame(self) -> pd.DataFrame:
        """The columns of track.csv, with `t` as the index. Raises InputError without pandas."""
        return track_to_table(self).frame()

    def plot(self) -> Plot:
        """The path, over the truth where the log has one."""
        shown = [Curve(self.x, self.y, "fused", COLOURS["fused"], 2.0)]
        if self.truth is not None:
            shown.insert(0, Curve(self.truth["x"], self.truth["y"], "truth", COLOURS["truth"], 5.0))
        return Plot(curves_figure(shown, "x, m", "y, m", height=5.0, equal=True))

    def save(self, folder: StrPath, *, force: bool = False) -> Path:
        """Write track.csv and fuse.json, as `hubodo fuse` does; the folder is made where it is missing.

        Raises InputError where results are there already, unless `force` is true.
        """
        target = Path(folder)
        if not force:
            check_no_results(target)
        write_results(self.fused, target)
        return target

    def __repr__(self) -> str:
        facts = dict(self.fused.summary_rows())
        off = f", final error {facts['final error']}" if "final error" in facts else ""
        return f"FusedTrack({len(self.t)} poses, {facts['duration']}, {facts['distance']}{off})"

    def _repr_html_(self) -> str:
        return html_table(("", ""), self.fused.summary_rows()) + html_lines(self.warnings)


def fused_track(fused: FusedRecording, truth: Table | None) -> FusedTrack:
    """The arrays of a result, with the result."""
    return FusedTrack(**vars(fused.track), fused=fused, truth=truth)
