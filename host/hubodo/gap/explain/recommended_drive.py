"""Figures of a gap result: residuals per step under a slider, and the recommended drive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from hubodo.arrays import Array
from hubodo.effects import distinguishing_manoeuvre
from hubodo.gap.explain.figures import Channel, envelope, format_channel
from hubodo.pages.page import COLOURS

if TYPE_CHECKING:
    from hubodo.gap.explain.missing_effects import MissingEffects

# Duration (s), speed (m/s) and yaw rate (rad/s) of one segment of a drive; transitions are smoothed.
DriveSegment = tuple[float, float, float]
_WARM_UP_SEGMENTS: tuple[DriveSegment, ...] = ((8.0, 1.5, 0.0),)
# Segments by keyword of the manoeuvres in the effects' `confusable_with`.
_SEGMENTS_BY_KEYWORD: Mapping[str, tuple[DriveSegment, ...]] = {
    "both ways": ((8.0, 2.5, 0.6), (3.0, 2.5, 0.0), (8.0, 2.5, -0.6)),
    "two speeds": ((10.0, 1.0, 0.0), (10.0, 3.0, 0.0)),
    "slowly and fast": ((12.0, 0.8, 0.0), (12.0, 3.0, 0.0)),
    "both directions": ((10.0, 2.0, 0.0), (5.2, 1.0, 0.6), (10.0, 2.0, 0.0)),
    "long and fast": ((25.0, 3.0, 0.0),),
    "briskly": ((4.0, 3.0, 0.0), (4.0, 0.5, 0.0), (4.0, 3.0, 0.0), (4.0, 0.5, 0.0)),
    "change speed": ((6.0, 2.5, 0.0), (6.0, 1.0, 0.0), (6.0, 2.5, 0.0)),
    "accelerate": ((4.0, 3.0, 0.0), (4.0, 0.3, 0.5), (4.0, 3.0, -0.5), (3.0, 0.3, 0.0)),
    "turn": ((8.0, 2.0, 0.5), (8.0, 2.0, -0.5)),
    "straight": ((15.0, 2.0, 0.0), (10.0, 1.5, 0.4)),
    "slowly": ((15.0, 0.6, 0.0), (8.0, 0.6, 0.3)),
    "fast": ((15.0, 3.0, 0.0),),
    "power-on": ((30.0, 0.0, 0.0), (15.0, 1.5, 0.0), (30.0, 0.0, 0.0)),
    "temperature": ((30.0, 0.0, 0.0), (15.0, 1.5, 0.0), (30.0, 0.0, 0.0)),
    "longer": ((30.0, 1.5, 0.2), (30.0, 2.0, -0.2)),
}
_SMOOTHING_S = 1.0
_PROFILE_STEP_S = 0.05


def slider_figure(result: MissingEffects, channels: Sequence[Channel]) -> go.Figure:
    """Return a figure of the mean residual of each second, grey for the given model, with a slider.

    In print it shows the initial slider position, with all effects.
    """
    channels = channels[:4]
    plot = make_subplots(len(channels), 1, shared_xaxes=True, vertical_spacing=0.1 / len(channels))
    for number, residuals in enumerate([result.residual_steps[0], *result.residual_steps]):
        for position, (name, row) in enumerate(channels, 1):
            residual = residuals[name]
            t, _, mean, _ = envelope(residual.node.t, residual.value[row])
            colour = COLOURS["truth"] if not number else COLOURS["left"]
            plot.add_scatter(
                x=t, y=mean, mode="lines", line={"width": 1.3, "color": colour}, showlegend=False,
                visible=number in (0, len(result.residual_steps)), row=position, col=1,
            )  # fmt: skip
            plot.update_yaxes(title_text=format_channel((name, row)), row=position, col=1)
    labels = ["as given", *(f"+ {finding.effect}" for finding in result.listed)][: len(result.residual_steps)]
    per_step = len(channels)
    steps = [
        {
            "label": label,
            "method": "update",
            "args": [
                {
                    "visible": [
                        k < per_step or k // per_step == number + 1
                        for k in range(per_step * (len(labels) + 1))
                    ]
                }
            ],
        }
        for number, label in enumerate(labels)
    ]
    plot.update_layout(
        template="plotly_white",
        height=150 + 150 * per_step,
        margin={"l": 60, "r": 70, "t": 20, "b": 40},
        sliders=[
            {
                "active": len(labels) - 1,
                "steps": steps,
                "pad": {"t": 40},
                "currentvalue": {"prefix": "model: "},
            }
        ],
    )
    plot.update_xaxes(title_text="time, s", row=per_step, col=1)
    return plot


def recommend_drives(result: MissingEffects) -> list[tuple[str, tuple[DriveSegment, ...]]]:
    """Return description and segments of a drive for each pair of effects not distinguished by this log."""
    plot: dict[str, tuple[DriveSegment, ...]] = {}
    for finding in result.found:
        for other in finding.inseparable_from:
            description = distinguishing_manoeuvre(finding.effect, other)
            if description:
                plot[f"{finding.effect} or {other}: {description}"] = parse_manoeuvre(description)
    return list(plot.items())


def parse_manoeuvre(description: str) -> tuple[DriveSegment, ...]:
    """Return the segments of a manoeuvre given in words; a generic drive if no keyword is known."""
    matches = [
        segments_of_drive for key, segments_of_drive in _SEGMENTS_BY_KEYWORD.items() if key in description
    ]
    return (
        *_WARM_UP_SEGMENTS,
        *(
            stretch
            for segments_of_drive in matches[:2] or [_SEGMENTS_BY_KEYWORD["longer"]]
            for stretch in segments_of_drive
        ),
    )


def drive_figure(segments_of_drive: Sequence[DriveSegment]) -> go.Figure:
    """Return a figure of a drive: speed and yaw rate over time, and the path from above."""
    t, speed, yaw_rate = _profile(segments_of_drive)
    heading = np.cumsum(yaw_rate) * _PROFILE_STEP_S
    x, y = (
        np.cumsum(speed * np.cos(heading)) * _PROFILE_STEP_S,
        np.cumsum(speed * np.sin(heading)) * _PROFILE_STEP_S,
    )
    plot = make_subplots(
        2, 2, specs=[[{}, {"rowspan": 2}], [{}, None]], shared_xaxes=True,
        column_widths=[0.6, 0.4], horizontal_spacing=0.12,
    )  # fmt: skip
    line = {"width": 2.0, "color": COLOURS["left"]}
    plot.add_scatter(x=t, y=speed, mode="lines", line=line, row=1, col=1)
    plot.add_scatter(x=t, y=np.degrees(yaw_rate), mode="lines", line=line, row=2, col=1)
    plot.add_scatter(x=x, y=y, mode="lines", line=line, row=1, col=2)
    plot.update_yaxes(title_text="speed, m/s", row=1, col=1)
    plot.update_yaxes(title_text="yaw rate, °/s", row=2, col=1)
    plot.update_yaxes(title_text="path, m", scaleanchor="x2", scaleratio=1.0, row=1, col=2)
    plot.update_xaxes(title_text="time, s", row=2, col=1)
    plot.update_layout(
        template="plotly_white", height=320, showlegend=False, margin={"l": 60, "r": 20, "t": 20, "b": 40}
    )
    return plot


def _profile(segments_of_drive: Sequence[DriveSegment]) -> tuple[Array, Array, Array]:
    """Return times, speed and yaw rate, from standstill to standstill."""
    segments = [(2.0, 0.0, 0.0), *segments_of_drive, (2.0, 0.0, 0.0)]
    counts = [round(seconds / _PROFILE_STEP_S) for seconds, _, _ in segments]
    speed = np.repeat([speed for _, speed, _ in segments], counts)
    yaw_rate = np.repeat([rate for _, _, rate in segments], counts)
    kernel = np.hanning(round(2.0 * _SMOOTHING_S / _PROFILE_STEP_S) + 1)
    kernel = kernel / kernel.sum()
    t = np.asarray(np.arange(len(speed)) * _PROFILE_STEP_S, float)
    return t, np.convolve(speed, kernel, "same"), np.convolve(yaw_rate, kernel, "same")
