"""Odometry made absolute: the factor graph over a recording's GNSS fixes and headings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.heading import Headings
from hubodo.fuse.graph.fixes import Fixes
from hubodo.fuse.graph.graph import fuse_graph
from hubodo.fuse.graph.outages import outages
from hubodo.fuse.graph.review import COUNTS
from hubodo.fuse.graph.steps import path_of
from hubodo.fuse.track import Track
from hubodo.fuse.wheels import WheelOdometry, start_heading
from hubodo.recording import Recording

_SEEN = 0.9
"""Of the prior's sigma: a constant that has not shrunk by a tenth is the prior's, not this drive's."""


@dataclass(frozen=True)
class AbsoluteTrack:
    """The graph's track from its start, what it learnt for fuse.json, and warnings."""

    track: Track
    method: str
    learnt: Mapping[str, Any]
    warnings: tuple[str, ...]


def absolute_track(
    recording: Recording, odometry: WheelOdometry, antenna: tuple[float, float] = (0.0, 0.0)
) -> AbsoluteTrack:
    """The most probable track of odometry with the fixes or headings, or both, of a recording.

    antenna: m forward and left of the body origin. Axes are east and north where there are fixes. Raises
    InputError when there are fixes and none is usable.
    """
    gnss, compass = recording.gnss, recording.heading
    fixes = headings = None
    if gnss is not None:
        fixes = Fixes(gnss.t, gnss["latitude_deg"], gnss["longitude_deg"], gnss.columns.get("sigma"))
    if compass is not None:
        headings = Headings(compass.t, compass["heading"], compass.columns.get("sigma"))
    config = GraphConfig(antenna=antenna, constants=odometry.constants)
    heading = start_heading(recording, odometry.track.t[0])
    # Fixes tell the heading themselves; that of a truth that stands still may be anything.
    if heading is not None and fixes is None:
        config = replace(config, start_heading=heading)
    found = fuse_graph(path_of(odometry.track, odometry.loose), fixes, headings, config)
    prior = asdict(config.constants)
    seen = {
        name: {"value": q.value, "sigma": q.sigma}
        for name, q in found.constants.items()
        if q.sigma < _SEEN * prior.get(name, float("inf"))
    }
    truth = None
    if recording.truth is not None:
        truth = (recording.truth.t, recording.truth["x"], recording.truth["y"])
    used = found.fix_t[found.fix_weight > COUNTS]
    gaps = outages(found.from_start, used, truth) if len(used) else ()
    learnt = {
        "fixes": len(found.fix_t),
        "constants": seen,
        "outages": [{key: value for key, value in asdict(gap).items() if value is not None} for gap in gaps],
    }
    parts = [f"{len(found.fix_t)} fixes"] if fixes is not None else []
    what = " and ".join([*parts, "headings"] if headings is not None else parts)
    return AbsoluteTrack(found.from_start, f"factor graph with {what}", {"graph": learnt}, found.warnings)
