"""The fused track as arrays, data frame, plot and files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hubodo.api.arguments import StrPath, as_calibration, as_vehicle
from hubodo.errors import InputError
from hubodo.fuse.fused_recording import FusedRecording, check_no_results, track_to_table, write_results
from hubodo.fuse.fusion import fuse_recording, parse_smoothing_lag
from hubodo.fuse.track import Score, Track
from hubodo.html_table import html_lines, html_table
from hubodo.pages.curves import Curve, plot_curves
from hubodo.pages.page import COLOURS
from hubodo.pages.plot import Plot
from hubodo.recording import Table

if TYPE_CHECKING:
    import pandas as pd

    from hubodo.api.log import LoadedLog
    from hubodo.calibration.file import Calibration
    from hubodo.fuse.wheel_odometry import Method
    from hubodo.vehicle import Vehicle


@dataclass(frozen=True, eq=False, repr=False)
class FusedTrack(Track):
    """The estimated track of a vehicle; all arrays have one entry for each pose.

    Attributes
    ----------
    t : (N,) array
        Time on the clock of the log, s.
    x, y : (N,) array
        Position relative to the start, m; east and north if the log has absolute positions.
    heading : (N,) array
        Heading, rad, anticlockwise from x, unwrapped.
    speed : (N,) array
        Speed, m/s.
    sigma_x, sigma_y : (N,) array
        1σ of the position, m; it grows from zero at the start.
    sigma_heading : (N,) array
        1σ of the heading, rad.
    cov_xy, cov_x_heading, cov_y_heading : (N,) array
        Covariances of x with y, m², and of x and y with the heading, m rad.
    yaw_rate : array
        Yaw rate, rad/s; empty where GNSS or headings were used.
    step_inflation : array
        Variance of each step beyond that of rolling wheels, m²; empty as `yaw_rate`.
    fused : Fused
        The complete result: `methods`, `nodes`, `details`, `warnings`.
    truth : Table or None
        The table `truth` of the log.
    """

    fused: FusedRecording = field(kw_only=True)
    truth: Table | None = field(default=None, kw_only=True)

    @property
    def score(self) -> Score | None:
        """Errors against the truth in m, % and rad; None if the log has no truth."""
        return self.fused.score

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings, one line each."""
        return self.fused.warnings

    def as_json(self) -> dict[str, Any]:
        """Return the content of fuse.json.

        Returns
        -------
        dict
            The JSON object.
        """
        return self.fused.as_json()

    def frame(self) -> pd.DataFrame:
        """Return the columns of track.csv as a pandas data frame.

        Returns
        -------
        pandas.DataFrame
            The columns, indexed by `t`.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        return track_to_table(self).frame()

    def plot(self) -> Plot:
        """Plot the path, over the truth if the log has one.

        Returns
        -------
        Plot
            The figure.
        """
        curves = [Curve(self.x, self.y, "fused", COLOURS["fused"], 2.0)]
        if self.truth is not None:
            curves.insert(0, Curve(self.truth["x"], self.truth["y"], "truth", COLOURS["truth"], 5.0))
        return Plot(plot_curves(curves, "x, m", "y, m", height=5.0, equal=True))

    def save(self, folder: StrPath, *, force: bool = False) -> Path:
        """Write track.csv and fuse.json, as `hubodo fuse` does.

        Parameters
        ----------
        folder : str or path-like
            Folder for the files; it is created if missing.
        force : bool
            Replace existing results.

        Returns
        -------
        Path
            The folder.

        Raises
        ------
        InputError
            If results exist and `force` is False.
        """
        target = Path(folder)
        if not force:
            check_no_results(target)
        write_results(self.fused, target)
        return target

    def __repr__(self) -> str:
        facts = dict(self.fused.summary_rows())
        error = f", final error {facts['final error']}" if "final error" in facts else ""
        return f"FusedTrack({len(self.t)} poses, {facts['duration']}, {facts['distance']}{error})"

    def _repr_html_(self) -> str:
        return html_table(("", ""), self.fused.summary_rows()) + html_lines(self.warnings)


def fuse_log(
    log: LoadedLog,
    vehicle: StrPath | Vehicle | None,
    *,
    calibration: StrPath | Calibration | None,
    nodes: Sequence[str] | None,
    method: Method,
    smooth: float | Literal["full"],
    graph: bool,
    antenna: tuple[float, float] | None,
) -> FusedTrack:
    """Estimate the track of a log; see `LoadedLog.fuse`."""
    lag = parse_smoothing_lag(smooth, method, "smooth =")
    used_vehicle = log.vehicle if vehicle is None else as_vehicle(vehicle)
    if used_vehicle is None:
        raise InputError(f"{log.path}: holds no vehicle; give a vehicle file")
    used_calibration, source = as_calibration(calibration)
    fused = fuse_recording(
        log.recording,
        used_vehicle,
        log=str(log.path),
        method=method,
        nodes=nodes,
        calibration=used_calibration,
        calibration_from=source,
        lag=lag,
        graph=graph,
        antenna=antenna,
    )
    return FusedTrack(**vars(fused.track), fused=fused, truth=log.recording.truth)
