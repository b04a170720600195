"""Page of a wheel calibration: verdict and held-out errors, then parameters, then those not observable."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hubodo.calibration.parameter_table import (
    SIGNIFICANT_SIGMA,
    format_with_sigma,
    parameter_headings,
    parameter_rows,
)
from hubodo.pages.page import PageTable, Section, render_page

if TYPE_CHECKING:
    from hubodo.fuse.wheel.calibration.result import WheelCalibration


def wheel_calibration_page(result: WheelCalibration, log: str) -> str:
    """Return the page; log: name of the drive."""
    check = result.held_out
    if check.n_segments:
        lead = (
            f"On segments that it did not see, the calibration changes the error from "
            f"{check.before.median:.3f} m to {check.after.median:.3f} m (median of {check.n_segments})."
        )
        rows = [
            ("median", f"{check.before.median:.3f} m", f"{check.after.median:.3f} m"),
            ("rms", f"{check.before.rms:.3f} m", f"{check.after.rms:.3f} m"),
        ]
        verdict = Section(
            "Before and after",
            "Each segment is predicted by a calibration on the others.",
            [PageTable(("error on held-out segments", "before", "after"), rows)],
        )
    else:
        lead = "The drive is too short for a held-out check: the gain is not verified."
        verdict = Section(
            "Before and after", f"Before calibration the track deviated by {result.rms:.2f} m rms."
        )
    parameters = [
        Section(
            f"Parameters of {name}",
            f"Significant are values beyond {SIGNIFICANT_SIGMA:.0f} of their own sigma.",
            [PageTable(parameter_headings(), list(parameter_rows(effects)))],
        )
        for name, effects in (*result.nodes.items(), ("the vehicle", result.vehicle))
        if effects
    ]
    forward, left = (f"{format_with_sigma(q.value, q.sigma)} m" for q in result.antenna)
    positions = [
        ("positions", f"{result.n_positions} ({result.source})"),
        ("white noise of a position", f"{result.white_sigma:.2g} m (1σ)"),
        ("slow error of the positions", f"{result.slow_sigma:.2g} m (1σ)"),
        ("jumps of the positions", str(result.n_jumps)),
        ("antenna", f"{forward} forward, {left} to the left"),
    ]
    hidden = Section("Not observable in this drive", advice=result.not_observable, is_folded=True)
    warnings = Section("Warnings", advice=result.warnings)
    sections = [
        verdict,
        *([warnings] if result.warnings else []),
        *parameters,
        Section("The positions", tables=[PageTable(("", ""), positions)]),
        *([hidden] if result.not_observable else []),
    ]
    return render_page(f"Wheel calibration from {log}", lead, sections)
