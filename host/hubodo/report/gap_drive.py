"""Figures of a gap result: residuals per step under a slider, and the recommended drive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from hubodo.arrays import Array
from hubodo.effects import distinguishing_manoeuvre
from hubodo.gap.explain.result import GapResult
from hubodo.report.gap_figures import Channel, envelope, format_channel
from hubodo.report.page import COLOURS

# Duration (s), speed (m/s) and yaw rate (rad/s) of one segment of a drive; transitions are smoothed.
DriveSegment = tuple[float, float, float]
_STRAIGHT: tuple[DriveSegment, ...] = ((8.0, 1.5, 0.0),)
# What a manoeuvre's words ask for, in the words of the effects' own `alike`.
_MOVES: Mapping[str, tuple[DriveSegment, ...]] = {
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
_SMOOTH = 1.0
_STEP = 0.05


def slider_figure(result: GapResult, chosen: Sequence[Channel]) -> go.Figure:
    """Return a figure of the mean residual of each second, grey for the given model, with a slider over effects.

    In print it shows the initial slider position, with all effects.
    """
    chosen = chosen[:4]
    made = make_subplots(len(chosen), 1, shared_xaxes=True, vertical_spacing=0.1 / len(chosen))
    for number, residuals in enumerate([result.residual_steps[0], *result.residual_steps]):
        for place, (name, row) in enumerate(chosen, 1):
            residual = residuals[name]
            t, _, mean, _ = envelope(residual.node.t, residual.value[row])
            colour = COLOURS["truth"] if not number else COLOURS["left"]
            made.add_scatter(
                x=t, y=mean, mode="lines", line={"width": 1.3, "color": colour}, showlegend=False,
                visible=number in (0, len(result.residual_steps)), row=place, col=1,
            )  # fmt: skip
            made.update_yaxes(title_text=format_channel((name, row)), row=place, col=1)
    labels = ["as given", *(f"+ {it.effect}" for it in result.found)][: len(result.residual_steps)]
    per = len(chosen)
    steps = [
        {
            "label": label,
            "method": "update",
            "args": [
                {"visible": [k < per or k // per == number + 1 for k in range(per * (len(labels) + 1))]}
            ],
        }
        for number, label in enumerate(labels)
    ]
    made.update_layout(
        template="plotly_white",
        height=150 + 150 * per,
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
    made.update_xaxes(title_text="time, s", row=per, col=1)
    return made


def recommend_drives(result: GapResult) -> list[tuple[str, tuple[DriveSegment, ...]]]:
    """Return description and segments of a drive for each pair of effects that this log cannot distinguish."""
    made: dict[str, tuple[DriveSegment, ...]] = {}
    for finding in result.found:
        for other in finding.inseparable_from:
            words = distinguishing_manoeuvre(finding.effect, other)
            if words:
                made[f"{finding.effect} or {other}: {words}"] = parse_manoeuvre(words)
    return list(made.items())


def parse_manoeuvre(words: str) -> tuple[DriveSegment, ...]:
    """Return the segments of a manoeuvre given in words; a generic drive if no keyword is known."""
    found = [stretches for key, stretches in _MOVES.items() if key in words]
    return (*_STRAIGHT, *(stretch for stretches in found[:2] or [_MOVES["longer"]] for stretch in stretches))


def drive_figure(stretches: Sequence[DriveSegment]) -> go.Figure:
    """Return a figure of a drive: speed and yaw rate over time, and the path from above."""
    t, speed, yaw_rate = _profile(stretches)
    heading = np.cumsum(yaw_rate) * _STEP
    x, y = np.cumsum(speed * np.cos(heading)) * _STEP, np.cumsum(speed * np.sin(heading)) * _STEP
    made = make_subplots(
        2, 2, specs=[[{}, {"rowspan": 2}], [{}, None]], shared_xaxes=True,
        column_widths=[0.6, 0.4], horizontal_spacing=0.12,
    )  # fmt: skip
    line = {"width": 2.0, "color": COLOURS["left"]}
    made.add_scatter(x=t, y=speed, mode="lines", line=line, row=1, col=1)
    made.add_scatter(x=t, y=np.degrees(yaw_rate), mode="lines", line=line, row=2, col=1)
    made.add_scatter(x=x, y=y, mode="lines", line=line, row=1, col=2)
    made.update_yaxes(title_text="speed, m/s", row=1, col=1)
    made.update_yaxes(title_text="yaw rate, °/s", row=2, col=1)
    made.update_yaxes(title_text="path, m", scaleanchor="x2", scaleratio=1.0, row=1, col=2)
    made.update_xaxes(title_text="time, s", row=2, col=1)
    made.update_layout(
        template="plotly_white", height=320, showlegend=False, margin={"l": 60, "r": 20, "t": 20, "b": 40}
    )
    return made


def _profile(stretches: Sequence[DriveSegment]) -> tuple[Array, Array, Array]:
    """Return times, speed and yaw rate, from standstill to standstill."""
    whole = [(2.0, 0.0, 0.0), *stretches, (2.0, 0.0, 0.0)]
    counts = [round(seconds / _STEP) for seconds, _, _ in whole]
    speed = np.repeat([speed for _, speed, _ in whole], counts)
    yaw_rate = np.repeat([rate for _, _, rate in whole], counts)
    bell = np.hanning(round(2.0 * _SMOOTH / _STEP) + 1)
    bell = bell / bell.sum()
    t = np.asarray(np.arange(len(speed)) * _STEP, float)
    return t, np.convolve(speed, bell, "same"), np.convolve(yaw_rate, bell, "same")
