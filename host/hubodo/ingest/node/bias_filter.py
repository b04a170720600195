"""Reports of a node's own bias filter: conversion from the wire, log columns, JSON and text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from hubodo.ingest.node.identity import code_name
from hubodo.ingest.node.outputs import BiasFilterReport, Vector
from hubodo.recording import BIAS_FILTER_COLUMNS
from hubowire.messages import Filter, FilterState


def decode_filter_report(message: Filter, device_ns: int, gyro_lsb: float, t_ns: int) -> BiasFilterReport:
    """Return a filter report in SI units; gyro_lsb: rad/s per count of the gyro."""

    def vector(values: Iterable[float], factor: float) -> Vector:
        x, y, z = (value * factor for value in values)
        return x, y, z

    return BiasFilterReport(
        device_ns,
        message.state,
        message.samples,
        vector(message.rate_q8, gyro_lsb / 256.0),
        vector(message.bias_q12, gyro_lsb / 4096.0),
        vector((math.sqrt(variance / 256.0) for variance in message.variance_q8), gyro_lsb),
        vector((sigma or math.nan for sigma in message.bias_sigma_q12), gyro_lsb / 4096.0),
        message.saturations,
        t_ns,
    )


def filter_report_columns(report: BiasFilterReport) -> dict[str, float]:
    """Return the report as one row of the log channel, by column."""
    values = (
        report.state,
        report.samples,
        report.saturations,
        *report.rate,
        *report.bias,
        *report.noise,
        *report.bias_sigma,
    )
    return dict(zip(BIAS_FILTER_COLUMNS[1:], map(float, values), strict=True))


def filter_report_row(report: BiasFilterReport) -> dict[str, float]:
    """Return the row with its device time t, s, for `describe_filter_row`."""
    return {"t": report.device_ns * 1e-9, **filter_report_columns(report)}


def filter_report_json(report: BiasFilterReport | None) -> dict[str, Any] | None:
    """Return the report as JSON: rad/s; sigmas are None where the node does not know them."""
    if report is None:
        return None
    return {
        "state": code_name(FilterState, report.state),
        "samples": report.samples,
        "bias": list(report.bias),
        "sigma": [None if math.isnan(sigma) else sigma for sigma in report.bias_sigma],
    }


def describe_filter_row(row: Mapping[str, float]) -> str:
    """Describe a row of the channel in one line: the bias with its sigma, and its origin."""
    if row["state"] != FilterState.TRACKING:
        return f"{code_name(FilterState, int(row['state']))}, bias unknown"
    bias = ", ".join(f"{axis} {_format_bias(row, axis)}" for axis in "xyz")
    samples = int(row["samples"])
    origin = f"from {samples} samples" if samples else "from the node's settings"
    return f"{bias} °/s, {origin}"


def _format_bias(row: Mapping[str, float], axis: str) -> str:
    bias, sigma = math.degrees(row[f"bias_{axis}"]), math.degrees(row[f"sigma_{axis}"])
    return f"{bias:+.3f}" if math.isnan(sigma) else f"{bias:+.3f} ± {sigma:.3f}"
