"""Fusion of a whole log: wheel odometry, a factor graph with outside sensors, and a score against truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from hubodo.calibration.file import Calibration
from hubodo.errors import InputError
from hubodo.fuse.fused_recording import FusedRecording
from hubodo.fuse.graph.batch import fuse_graph
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.factor import SensorSamples
from hubodo.fuse.graph.factors.heading import Headings
from hubodo.fuse.graph.fixes import Fixes
from hubodo.fuse.graph.result import GraphResult
from hubodo.fuse.graph.review import MIN_USED_WEIGHT
from hubodo.fuse.track import Score, Track, find_gnss_outages, score_track
from hubodo.fuse.wheel_odometry import Method, WheelOdometry, compute_wheel_odometry, read_start_heading
from hubodo.garbage_collection import rare_garbage_collection
from hubodo.log.units import check_units
from hubodo.recording import Recording, Table
from hubodo.vehicle import Vehicle

SAMPLES_BY_TABLE: Mapping[str, Callable[[Table], SensorSamples]] = {
    "heading": Headings.from_table,
}
"""Sensors beside wheels and GNSS: the table of a recording, and how it becomes samples of the graph."""

_MAX_SIGMA_RATIO = 0.9
"""Ratio of sigma to prior sigma: a constant whose sigma fell by less than a tenth is not reported."""

_MAX_RADIUS_SIGMAS = 3.0
"""Sigmas of the prior beyond which the radius that fixes show is reported: one in 370 by chance."""
_HELD_SIGMA = 1e-6
"""Sigma of a constant that the graph held at zero; those of a compass are held without headings."""
_TRUTH_HEADING_SIGMA = 2e-3
"""rad; a reference system with two antennas or a survey of the start."""


@rare_garbage_collection()
def fuse_recording(
    recording: Recording,
    vehicle: Vehicle,
    *,
    log: str,
    method: Method = "filter",
    nodes: Sequence[str] | None = None,
    calibration: Calibration | None = None,
    calibration_from: Mapping[str, str] | None = None,
    lag: float = 0.0,
    graph: bool = True,
    antenna: tuple[float, float] | None = None,
) -> FusedRecording:
    """Fuse a recording into a track.

    Parameters
    ----------
    log : name of the log, for errors and the result.
    nodes : names of the nodes to use, all that sit on wheels by default.
    calibration : applied to the samples, or used as a prior where it cannot be.
    calibration_from : file and hash of the calibration.
    lag : s by which the samples used for a pose may be later than it; inf for the whole log.
    graph : whether GNSS fixes and headings of the log are used.
    antenna : m forward and left of midway between the wheels; None: the vehicle's.

    Raises
    ------
    InputError, CalibrationError
        As `compute_wheel_odometry` and `fuse_outside_sensors`, and for samples in wrong units.
    """
    check_units(recording, vehicle.nodes, log)
    graph = graph and any(getattr(recording, name) is not None for name in ("gnss", *SAMPLES_BY_TABLE))
    odometry = compute_wheel_odometry(
        recording,
        vehicle,
        log=log,
        method=method,
        nodes=nodes,
        calibration=calibration,
        lag=lag,
        for_graph=graph,
    )
    track, methods = odometry.track, [odometry.method]
    details = {**odometry.details, "t_zero_ns": recording.t_zero_ns}
    warnings = recording.warnings + odometry.warnings
    if graph:
        result = fuse_outside_sensors(recording, odometry, antenna or vehicle.antenna or (0.0, 0.0))
        track = result.from_start
        methods.append(f"factor graph with {' and '.join(_outside_sensors(recording, result))}")
        details["graph"] = _graph_details(recording, odometry, result)
        warnings += result.warnings + _radius_warnings(vehicle, odometry, result)
    score = score_against_truth(track, recording)
    return FusedRecording(
        log,
        track,
        tuple(methods),
        lag,
        odometry.nodes,
        details,
        calibration_from,
        score,
        warnings + _true_heading_warnings(score, track),
    )


def _true_heading_warnings(score: Score | None, track: Track) -> tuple[str, ...]:
    """Return a warning if most of the error is a rotation of the track that its heading does not explain."""
    if score is None or score.rotation is None or score.rotated_maximum_error is None:
        return ()
    if abs(score.rotation) < 3.0 * track.sigma_heading.max():
        return ()
    if score.rotated_maximum_error > 0.5 * score.maximum_error:
        return ()
    turned = math.degrees(score.rotation)
    return (
        f"truth: the largest error is {score.maximum_percent:.2f} % of the path, and "
        f"{score.rotated_maximum_percent:.2f} % once the track is rotated by {turned:+.2f}° about its start; "
        "the truth may report a wrong heading while the vehicle stands",
    )


def fuse_outside_sensors(
    recording: Recording, odometry: WheelOdometry, antenna: tuple[float, float] = (0.0, 0.0)
) -> GraphResult:
    """Return the maximum a posteriori track of wheel odometry with the fixes and headings of a recording.

    antenna: m forward and left of the body origin. Axes are east and north where there are fixes. Raises
    InputError when there are fixes and none is usable.
    """
    gnss, fixes = recording.gnss, None
    if gnss is not None:
        fixes = Fixes(gnss.t, gnss["latitude_deg"], gnss["longitude_deg"], gnss.columns.get("sigma"))
    tables = ((getattr(recording, name), from_table) for name, from_table in SAMPLES_BY_TABLE.items())
    samples = [from_table(table) for table, from_table in tables if table is not None]
    config = GraphConfig(antenna=antenna, constants=odometry.constant_sigmas)
    # Compass headings enter the graph as samples; only a ground truth sets the start heading directly.
    heading = read_start_heading(replace(recording, heading=None), odometry.track.t[0])
    # Fixes determine the heading themselves, and the heading of a stationary truth may be arbitrary.
    if heading is not None and fixes is None:
        config = replace(config, start_heading=heading, start_heading_sigma=_TRUTH_HEADING_SIGMA)
    return fuse_graph(odometry.track, fixes, config=config, other_samples=samples)


def _radius_warnings(vehicle: Vehicle, odometry: WheelOdometry, result: GraphResult) -> tuple[str, ...]:
    """Return a warning if the fixes imply a wheel radius other than that of vehicle file or calibration."""
    error, prior = result.constants["wheel_radius"], odometry.constant_sigmas.wheel_radius
    if abs(error.value) < _MAX_RADIUS_SIGMAS * math.hypot(prior, error.sigma):
        return ()
    return (
        f"gnss: the fixes show a wheel radius of {vehicle.wheel_radius * (1.0 + error.value):.4g} m "
        f"({error.value:+.1%}), more than its 1σ of {prior:.1%} explains; correct wheel_radius in the "
        "vehicle file, and state radius_from",
    )


def _outside_sensors(recording: Recording, result: GraphResult) -> list[str]:
    """Return the names of the sensors other than wheels, for the name of the method."""
    fixes = [] if recording.gnss is None else [f"{len(result.fix_t)} fixes"]
    return fixes + [f"{name}s" for name in SAMPLES_BY_TABLE if getattr(recording, name) is not None]


def _graph_details(recording: Recording, odometry: WheelOdometry, result: GraphResult) -> dict[str, Any]:
    """Return the entry `graph` of fuse.json: origin, number of fixes, observed constants, GNSS outages."""
    prior = asdict(odometry.constant_sigmas)
    observed = {
        name: {"value": q.value, "sigma": q.sigma}
        for name, q in result.constants.items()
        if _HELD_SIGMA < q.sigma < _MAX_SIGMA_RATIO * (prior.get(name) or float("inf"))
    }
    truth = None
    if recording.truth is not None:
        truth = (recording.truth.t, recording.truth["x"], recording.truth["y"])
    used = result.fix_t[result.fix_weight > MIN_USED_WEIGHT]
    gaps = find_gnss_outages(result.from_start, used, truth) if len(used) else ()
    return {
        **_origin_entry(result),
        "fixes": len(result.fix_t),
        "constants": observed,
        "outages": [{key: value for key, value in asdict(gap).items() if value is not None} for gap in gaps],
    }


def _origin_entry(result: GraphResult) -> dict[str, Any]:
    """Return latitude and longitude of the start of the track, if there are fixes."""
    if result.frame is None:
        return {}
    latitude, longitude = result.frame.to_geodetic(result.track.x[:1], result.track.y[:1])
    return {"origin": {"latitude_deg": float(latitude[0]), "longitude_deg": float(longitude[0])}}


def parse_smoothing_lag(smooth: float | str | None, method: str, option: str, hint: str = "") -> float:
    """Return the lag of the smoother, s: 0 for the forward filter, infinity for the whole log.

    smooth: seconds, "full", or None for 0. option, hint: name of the option and a remedy, for the error.
    Raises InputError for any other text.
    """
    try:
        lag = math.inf if smooth == "full" else float(smooth or 0.0)
    except ValueError:
        lag = math.nan
    if not lag >= 0.0:
        raise InputError(f"{option} {smooth}: give seconds from 0 on, or full{hint}")
    if lag > 0.0 and method != "filter":
        raise InputError(f"{option} {smooth}: only the method filter can smooth")
    return lag


def score_against_truth(track: Track, recording: Recording) -> Score | None:
    """Return the error of a track against the truth in its log, None where the log has none."""
    truth = recording.truth
    if truth is None:
        return None
    return score_track(track, truth.t, truth["x"], truth["y"], truth.columns.get("heading"))
