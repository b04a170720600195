"""The demo's page: path, speed and link statistics."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from hubodo.fuse.track import Track
from hubodo.pages.page import COLOURS, PageTable, Section, new_plotly_figure, render_page
from hubodo.recording import Recording, Table

_MAX_PLOT_POINTS = 4000


def demo_page(
    lead: str,
    facts: PageTable,
    track: Track,
    truth: Table,
    recording: Recording,
    links: PageTable,
    radius: float,
) -> str:
    """Return the page as HTML; `radius` in m converts the spin rate of a wheel to its speed."""
    return render_page(
        "A drive measured without an encoder",
        lead,
        [
            Section("Path", "The grey line is the simulated truth.", [facts], [_path_figure(track, truth)]),
            Section(
                "Speed",
                "Each wheel's speed from the gyro on its axle, and the speed of the vehicle from both.",
                [],
                [_speed_figure(track, truth, recording, radius)],
            ),
            Section(
                "Links",
                "Statistics of each node, and the number of samples received in each second.",
                [links],
                [_sample_rate_figure(recording)],
            ),
        ],
    )


def _make_curve(x: Any, y: Any, name: str, colour: str, width: float = 2.0) -> go.Scatter:
    step = max(1, len(x) // _MAX_PLOT_POINTS)
    line = {"color": COLOURS[colour], "width": width}
    return go.Scatter(x=np.round(x[::step], 4), y=np.round(y[::step], 4), name=name, mode="lines", line=line)


def _path_figure(track: Track, truth: Table) -> go.Figure:
    chart = new_plotly_figure("x, m", "y, m", height=460, equal=True)
    chart.add_trace(_make_curve(truth["x"], truth["y"], "truth", "truth", 6.0))
    chart.add_trace(_make_curve(track.x, track.y, "fused from the two wheels", "fused"))
    return chart


def _speed_figure(track: Track, truth: Table, recording: Recording, radius: float) -> go.Figure:
    chart = new_plotly_figure("time, s", "speed, m/s")
    chart.add_trace(_make_curve(truth.t, truth["speed"], "truth", "truth", 6.0))
    for name, node in recording.nodes.items():
        chart.add_trace(_make_curve(node.t, node["gz"] * radius, f"{name} wheel", name, 1.0))
    chart.add_trace(_make_curve(track.t, track.speed, "fused", "fused"))
    return chart


def _sample_rate_figure(recording: Recording) -> go.Figure:
    chart = new_plotly_figure("time, s", "samples per second", height=260)
    for name, node in recording.nodes.items():
        # The first and the last second are incomplete: they would look like losses.
        seconds = np.bincount(np.maximum(node.t.astype(np.int64), 0))[1:-1]
        chart.add_trace(_make_curve(np.arange(1, len(seconds) + 1), seconds, name, name))
    chart.update_yaxes(rangemode="tozero")
    return chart


def facts_grid(rows: Mapping[str, str]) -> PageTable:
    """Return a table with the columns label and value."""
    return PageTable(("", ""), [(key, value) for key, value in rows.items()])
