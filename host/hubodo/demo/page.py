"""The demo's page: path, speed and link statistics."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hubodo.fuse.track import Track
from hubodo.pages.curves import Curve, draw_curves
from hubodo.pages.drawing import Drawing
from hubodo.pages.page import COLOURS, PageTable, Section, render_page
from hubodo.recording import Recording, Table


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
                "Each wheel's speed from the gyro on its axle, and the speed of the vehicle from both. "
                "In a turn the outer wheel is faster.",
                [],
                [_speed_figure(track, truth, recording, radius)],
            ),
            Section(
                "Links",
                "Statistics of each node, and the number of samples received in each second. The rates "
                "differ because each sensor samples by its own oscillator, some percent off its nominal "
                "416 Hz, as real chips do; the clock drift is that of the board. The host estimates both.",
                [links],
                [_sample_rate_figure(recording)],
            ),
        ],
    )


def _make_curve(x: Any, y: Any, name: str, colour: str, width: float = 1.5) -> Curve:
    return Curve(np.asarray(x, np.float64), np.asarray(y, np.float64), name, COLOURS[colour], width)


def _path_figure(track: Track, truth: Table) -> Drawing:
    return draw_curves(
        [
            _make_curve(truth["x"], truth["y"], "truth", "truth", 5.0),
            _make_curve(track.x, track.y, "fused from the two wheels", "fused"),
        ],
        "x, m",
        "y, m",
        height=4.6,
        equal=True,
    )


def _speed_figure(track: Track, truth: Table, recording: Recording, radius: float) -> Drawing:
    curves = [_make_curve(truth.t, truth["speed"], "truth", "truth", 5.0)]
    for name, node in recording.nodes.items():
        curves.append(_make_curve(node.t, node["gz"] * radius, f"{name} wheel", name, 0.9))
    return draw_curves(
        [*curves, _make_curve(track.t, track.speed, "fused", "fused")], "time, s", "speed, m/s"
    )


def _sample_rate_figure(recording: Recording) -> Drawing:
    curves = []
    for name, node in recording.nodes.items():
        # The first and the last second are incomplete: they would look like losses.
        seconds = np.bincount(np.maximum(node.t.astype(np.int64), 0))[1:-1]
        curves.append(_make_curve(np.arange(1, len(seconds) + 1), seconds, name, name))
    return draw_curves(curves, "time, s", "samples per second", height=2.4, from_zero=True)


def facts_grid(rows: Mapping[str, str]) -> PageTable:
    """Return a table with the columns label and value."""
    return PageTable(("", ""), [(key, value) for key, value in rows.items()])
