"""A log in memory: tables by name, fusion, gap search, plot and file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from hubodo.api.sensor_methods import SensorMethods
from hubodo.errors import InputError
from hubodo.recording import Event, Recording, Table

# The rest is imported by the methods that need it: importing everything takes four times as long.
if TYPE_CHECKING:
    import pandas as pd

    from hubodo.api.arguments import StrPath
    from hubodo.api.track import FusedTrack
    from hubodo.calibration.file import Calibration
    from hubodo.fuse.wheel_odometry import Method
    from hubodo.gap.explain.missing_effects import MissingEffects
    from hubodo.model.model_file import Model
    from hubodo.pages.plot import Plot
    from hubodo.vehicle import Vehicle


class LoadedLog(SensorMethods):
    """A log in memory, as returned by `hubodo.open` and `hubodo.simulate`.

    Tables are accessed by name, as in `log["left"]["gz"]`: one for each node, and `reference`, `wheels`,
    `gnss`, `heading`, `table` and `truth` where the log has them.

    Attributes
    ----------
    path : Path
        Path of the log; the name of a simulated one.
    recording : Recording
        All tables, events and metadata of the log.
    """

    def __init__(self, path: Path, recording: Recording, vehicle: Vehicle | None = None) -> None:
        self.path = path
        self.recording = recording
        self._vehicle = vehicle

    @property
    def nodes(self) -> Mapping[str, Table]:
        """Nodes by name; columns `t,gx,gy,gz,ax,ay,az[,temperature][,supply]`, s, rad/s, m/s², °C, V."""
        return self.recording.nodes

    @property
    def events(self) -> tuple[Event, ...]:
        """Events during the recording: gaps, resets, connected and disconnected links."""
        return self.recording.events

    @property
    def warnings(self) -> tuple[str, ...]:
        """Damage and omissions found on reading, one line each."""
        return self.recording.warnings

    @property
    def duration(self) -> float:
        """Time from the first to the last row of any table, s."""
        spans = [(table.t[0], table.t[-1]) for table in self.recording.files().values() if len(table)]
        return float(max(end for _, end in spans) - min(start for start, _ in spans)) if spans else 0.0

    @cached_property
    def vehicle(self) -> Vehicle | None:
        """The vehicle given on opening, else the one stored in the log, else None."""
        if self._vehicle is not None or not self.path.exists():
            return self._vehicle
        from hubodo.api.stored_log import read_stored_vehicle

        return read_stored_vehicle(self.path)

    def __getitem__(self, name: str) -> Table:
        tables = self.recording.files()
        if name not in tables:
            raise InputError(f"{self.path}: no table {name!r}; it has {', '.join(tables) or 'none'}")
        return tables[name]

    def __contains__(self, name: object) -> bool:
        return name in self.recording.files()

    def __iter__(self) -> Iterator[str]:
        return iter(self.recording.files())

    def __len__(self) -> int:
        return len(self.recording.files())

    def frame(self, name: str | None = None, *, utc: bool = False) -> pd.DataFrame:
        """Return a table as a pandas data frame.

        Parameters
        ----------
        name : str, optional
            Name of the table; by default the only node.
        utc : bool
            Index the rows by UTC instead of by seconds since t = 0.

        Returns
        -------
        pandas.DataFrame
            One column for each column of the table.

        Raises
        ------
        InputError
            If there is no such table, several nodes, no pandas, or no date of t = 0 in the log.
        """
        frame = self[self._node(name) if name is None else name].frame()
        if utc:
            if not self.recording.t_zero_ns:
                raise InputError(f"{self.path}: does not hold the date of t = 0; remove utc")
            import pandas as pd

            offset_ns = np.rint(np.asarray(frame.index, np.float64) * 1e9).astype(np.int64)
            frame.index = pd.DatetimeIndex(self.recording.t_zero_ns + offset_ns, name="utc", tz="UTC")
        return frame

    def fuse(
        self,
        vehicle: StrPath | Vehicle | None = None,
        *,
        calibration: StrPath | Calibration | None = None,
        nodes: Sequence[str] | None = None,
        method: Method = "filter",
        smooth: float | Literal["full"] = 0.0,
        graph: bool = True,
        antenna: tuple[float, float] | None = None,
    ) -> FusedTrack:
        """Estimate the track of the vehicle with sigmas, as `hubodo fuse` does.

        Parameters
        ----------
        vehicle : str, path-like or Vehicle, optional
            Vehicle or model file; by default the vehicle stored in the log.
        calibration : str, path-like or Calibration, optional
            Calibration to apply.
        nodes : sequence of str, optional
            Wheel nodes to use; by default all.
        method : {"filter", "differential"}
            Error-state Kalman filter, or plain differential odometry.
        smooth : float or "full"
            Smoothing lag in s, or "full" for the whole log; 0 is the forward filter.
        graph : bool
            Use GNSS and headings of the log.
        antenna : tuple of float, optional
            GNSS antenna, m forward and left of the midpoint between the wheels.

        Returns
        -------
        FusedTrack
            Position, heading and speed over time.

        Raises
        ------
        InputError
            If there is no vehicle, a node is missing, or the log is too short or in other units.
        ConfigError
            If a vehicle or calibration file is invalid.
        CalibrationError
            If the calibration belongs to another node.
        """
        from hubodo.api.track import fuse_log

        return fuse_log(
            self,
            vehicle,
            calibration=calibration,
            nodes=nodes,
            method=method,
            smooth=smooth,
            graph=graph,
            antenna=antenna,
        )

    def gap(
        self,
        model: StrPath | Model | None = None,
        *,
        accept: Sequence[str] = (),
        reject: Sequence[str] = (),
    ) -> MissingEffects:
        """Find the effects that a model lacks to explain this log, as `hubodo gap` does.

        Parameters
        ----------
        model : str, path-like or Model, optional
            Model file; by default the vehicle of this log, with noise and inputs estimated from the log.
        accept : sequence of str
            Effects to add to the model before the search.
        reject : sequence of str
            Effects not to consider; `empirical` excludes empirical terms.

        Returns
        -------
        MissingEffects
            The detected effects with sigmas and confidences, and the model with them added.

        Raises
        ------
        InputError
            If the log lacks what the model needs, or an effect does not exist.
        ConfigError
            If the model file is invalid.
        """
        from hubodo.api.gap_search import search_gap

        return search_gap(self, model, accept, reject)

    def plot(self, channel: str = "gz") -> Plot:
        """Plot a channel of all nodes over time.

        Parameters
        ----------
        channel : str
            Column of the nodes, such as `gz`.

        Returns
        -------
        Plot
            One curve for each node.

        Raises
        ------
        InputError
            If no node has the column.
        """
        from hubodo.api.plot import plot_channel

        return plot_channel(self, channel)

    def save(self, path: StrPath) -> Path:
        """Write the log as an MCAP file or as a folder of CSV files.

        Parameters
        ----------
        path : str or path-like
            An MCAP file (`.mcap`), or else a folder; it must not exist.

        Returns
        -------
        Path
            The file or folder.

        Raises
        ------
        InputError
            If the path exists.
        """
        from hubodo.api.stored_log import write_log

        return write_log(self.recording, Path(path), self._vehicle)

    def __repr__(self) -> str:
        return f"LoadedLog({str(self.path)!r}: {', '.join(self) or 'empty'}; {self.duration:.1f} s)"

    def _repr_html_(self) -> str:
        return self.recording._repr_html_()
