"""The demo's page: where the vehicle went, how fast, and how its links did."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from hubodo.fuse.track import Track
from hubodo.recording import Recording, Table
from hubodo.report.page import COLOURS, Grid, Section, figure, page

_MOST_POINTS = 4000


def demo_page(
    lead: str, facts: Grid, track: Track, truth: Table, recording: Recording, links: Grid, radius: float
) -> str:
    """The page as text. radius: m, turns a wheel's spin rate into its speed."""
    return page(
        "A ride measured without an encoder",
        lead,
        [
            Section("Where it went", "The grey line is the simulated truth.", [facts], [_path(track, truth)]),
            Section(
                "How fast",
                "Each wheel's speed from the gyro on its axle, and the speed of the vehicle from both.",
                [],
                [_speed(track, truth, recording, radius)],
            ),
            Section(
                "How the links did",
                "What each node delivered, and how many samples came in each second.",
                [links],
                [_arrivals(recording)],
            ),
        ],
    )


def _line(x: Any, y: Any, name: str, colour: str, width: float = 2.0) -> go.Scatter:
    step = max(1, len(x) // _MOST_POINTS)
    line = {"color": COLOURS[colour], "width": width}
    return go.Scatter(x=np.round(x[::step], 4), y=np.round(y[::step], 4), name=name, mode="lines", line=line)


def _path(track: Track, truth: Table) -> go.Figure:
    made = figure("x, m", "y, m", height=460, equal=True)
    made.add_trace(_line(truth["x"], truth["y"], "truth", "truth", 6.0))
    made.add_trace(_line(track.x, track.y, "fused from the two wheels", "fused"))
    return made


def _speed(track: Track, truth: Table, recording: Recording, radius: float) -> go.Figure:
    made = figure("time, s", "speed, m/s")
    made.add_trace(_line(truth.t, truth["speed"], "truth", "truth", 6.0))
    for name, node in recording.nodes.items():
        made.add_trace(_line(node.t, node["gz"] * radius, f"{name} wheel", name, 1.0))
    made.add_trace(_line(track.t, track.speed, "fused", "fused"))
    return made


def _arrivals(recording: Recording) -> go.Figure:
    made = figure("time, s", "samples per second", height=260)
    for name, node in recording.nodes.items():
        # The first and the last second are cut off somewhere: they would look like losses.
        seconds = np.bincount(np.maximum(node.t.astype(np.int64), 0))[1:-1]
        made.add_trace(_line(np.arange(1, len(seconds) + 1), seconds, name, name))
    made.update_yaxes(rangemode="tozero")
    return made


def facts_grid(rows: Mapping[str, str]) -> Grid:
    """Two columns: what, and how much."""
    return Grid(("", ""), [(key, value) for key, value in rows.items()])
