"""Heading and north of a log in memory."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hubodo.api.arguments import StrPath, as_calibration
from hubodo.errors import InputError
from hubodo.log.units import check_node_units
from hubodo.sensors.heading.estimate import HeadingOptions, effects_of_node, heading_from_recording
from hubodo.sensors.heading.prior import read_bias_noise
from hubodo.sensors.heading.result import HeadingResult
from hubodo.sensors.north.from_recordings import NorthOptions, north_from_recordings
from hubodo.sensors.north.measurements import METHODS
from hubodo.sensors.north.measurements import Method as NorthMethod
from hubodo.sensors.north.plan import read_drift_noise
from hubodo.sensors.north.result import NorthResult

if TYPE_CHECKING:
    from hubodo.api.sensor_methods import SensorMethods
    from hubodo.calibration.file import Calibration


def estimate_log_heading(
    log: SensorMethods,
    node: str,
    axis: str,
    calibration: StrPath | Calibration | None,
    allan: StrPath | None,
    age: float | None,
    standstills: Sequence[tuple[float, float]],
    scale_sigma: float | None,
    lag: float | None,
    step: float,
) -> HeadingResult:
    """Return the heading of a node; parameters as in `LoadedLog.heading`."""
    if axis not in ("x", "y", "z"):
        raise InputError(f"axis {axis!r}: choose from x, y, z")
    if not 1e-3 <= step <= 60.0:
        raise InputError(f"step = {step}: give 0.001 to 60 s")
    read, file = as_calibration(calibration)
    source = "the calibration" if file is None else file["file"]
    where = f"{log.path}, node {node}"
    check_node_units(log.recording.nodes[node], where)
    try:
        options = HeadingOptions(
            axis=axis,
            effects={} if read is None else effects_of_node(read, node, source),
            noise=None if allan is None else read_bias_noise(Path(allan)),
            age=age,
            standstills=standstills,
            scale_sigma=scale_sigma,
            lag=lag,
            step=step,
        )
        return heading_from_recording(log.recording, node, options, log=str(log.path))
    except InputError as error:
        raise InputError(f"{where}, {axis}: {error}") from None


def find_log_north(
    log: SensorMethods,
    node: str,
    axis: str,
    *,
    latitude_deg: float,
    method: NorthMethod,
    near_deg: float | None,
    calibration: StrPath | Calibration | None,
    allan: StrPath | None,
    settle: float | None,
    find_stops: bool,
    scale_sigma: float | None,
) -> NorthResult:
    """Return the azimuth of table zero from a node; parameters as in `LoadedLog.north`."""
    if axis not in ("x", "y", "z"):
        raise InputError(f"axis {axis!r}: choose from x, y, z")
    if method not in METHODS:
        raise InputError(f"method {method!r}: choose from {', '.join(METHODS)}")
    if scale_sigma is not None and not 0.0 < scale_sigma <= 0.2:
        raise InputError(f"scale_sigma = {scale_sigma}: give a fraction above 0, up to 0.2")
    options = NorthOptions(
        latitude_deg,
        (axis,),
        method,
        near_deg,
        settle,
        find_stops,
        None,
        scale_sigma,
        as_calibration(calibration)[0],
        None if allan is None else read_drift_noise(Path(allan)),
    )
    return north_from_recordings([(str(log.path), log.recording)], [node], options)
