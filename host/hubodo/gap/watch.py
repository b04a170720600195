"""Gap search over the newest minute of a growing recording, which reports each finding once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hubodo.effects.empirical import PREFIX
from hubodo.errors import InputError
from hubodo.gap.explain.missing_effects import MissingEffects
from hubodo.gap.explain.result import Finding
from hubodo.gap.explain.summary import format_estimate
from hubodo.gap.problem.assumed import assume_model
from hubodo.gap.problem.build import MIN_DURATION
from hubodo.gap.state.terms import ALL, VEHICLE
from hubodo.gap.workflow import find_gap
from hubodo.model.model_file import Model
from hubodo.recording import Recording, Table
from hubodo.vehicle import Vehicle

# s, length of the searched end of the log; s, time that a wheel has to turn in it; rad/s, its least spin.
_WATCHED_DURATION, _MIN_TURNING_TIME, _MIN_WATCHED_SPIN = 60.0, 12.0, 1.0
# s of samples that each node must have; inputs derived from them end slightly earlier.
_MIN_WATCHED_DURATION = MIN_DURATION + 2.0
# Confidence, and share of the excess over noise, from which on a finding is reported.
_MIN_REPORTED_CONFIDENCE, _MIN_REPORTED_SHARE = 0.99, 0.1


class GapWatch:
    """Repeated search of a growing recording with only the geometry of the vehicle given."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._reported: set[str] = set()

    def find_new_effects(self, recording: Recording) -> list[str]:
        """Return new findings, one line each."""
        newest = _cut_newest(recording)
        if not any(self._is_turning(name, table) for name, table in newest.nodes.items()):
            return []
        if (
            min(float(table.t[-1] - table.t[0]) for table in newest.nodes.values() if len(table))
            < _MIN_WATCHED_DURATION
        ):
            return []
        try:
            result = find_gap(newest, assume_model(newest, self._vehicle))
        except InputError as error:
            return self._report_once(str(error), f"gap: {error}")
        lines = []
        for finding in result.found:
            if not finding.effect.startswith(PREFIX) and _is_reportable(finding, result):
                lines += self._report_once(
                    f"{finding.effect} {finding.scope}", describe_finding(finding, result.model)
                )
        return lines

    def _is_turning(self, name: str, table: Table) -> bool:
        mount = self._vehicle.nodes.get(name)
        if mount is None or mount.side is None or len(table) < 2:
            return False
        turning = np.abs(table["gz"][1:]) > _MIN_WATCHED_SPIN
        return float(np.sum(np.diff(table.t) * turning)) > _MIN_TURNING_TIME

    def _report_once(self, key: str, line: str) -> list[str]:
        if key in self._reported:
            return []
        self._reported.add(key)
        return [line]


def describe_finding(finding: Finding, model: Model) -> str:
    """Return a finding as one line, such as "left: the IMU sits 0.15 m off the hub"."""
    node = None if finding.scope in (ALL, VEHICLE) else finding.scope
    effect = next(
        item.effect for item in model.effects if (item.effect.name, item.node) == (finding.effect, node)
    )
    place = {ALL: "all nodes", VEHICLE: "the vehicle"}.get(finding.scope, finding.scope)
    description = effect.describe()
    if not description:
        values = ", ".join(f"{name} {format_estimate(item)}" for name, item in finding.parameters.items())
        description = f"{effect.meaning} ({values})"
    return f"{place}: {description}"


def _is_reportable(finding: Finding, result: MissingEffects) -> bool:
    floor = result.gap.floor or 1.0
    excess = result.gap.before**2 - floor**2
    explained_share = (finding.gap.before**2 - finding.gap.after**2) / excess if excess > 0.0 else 0.0
    return finding.confidence >= _MIN_REPORTED_CONFIDENCE and explained_share >= _MIN_REPORTED_SHARE


def _cut_newest(recording: Recording) -> Recording:
    ends = [float(table.t[-1]) for table in recording.nodes.values() if len(table)]
    since = max(ends, default=0.0) - _WATCHED_DURATION
    nodes = {}
    for name, table in recording.nodes.items():
        is_new = table.t >= since
        nodes[name] = Table({column: table[column][is_new] for column in table})
    return replace(recording, nodes=nodes, reference=None)
