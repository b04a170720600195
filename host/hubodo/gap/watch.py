"""The gap of a drive that is still being recorded: what its newest minute shows, each thing told once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hubodo.effects.empirical import PREFIX
from hubodo.errors import InputError
from hubodo.gap.problem.assumed import assumed_model
from hubodo.gap.problem.build import SHORTEST
from hubodo.gap.state.terms import ALL, VEHICLE
from hubodo.gap.tell.account import handy
from hubodo.gap.tell.result import Finding, GapResult
from hubodo.gap.workflow import find_gap
from hubodo.model.model_file import Model
from hubodo.recording import Recording, Table
from hubodo.vehicle import Vehicle

# s: what is looked at, and how long a wheel has to turn, at so many rad/s or more, before anything is said.
_NEWEST, _TURNING, _TURNS = 60.0, 12.0, 1.0
# s: what each node has to have; inputs made of its samples end a little before them.
_LEAST = SHORTEST + 2.0
# A finding is told when it is so sure and so much of what exceeds the noise.
_SURE, _SHARE = 0.99, 0.1


class GapWatch:
    """Looks at a recording as it grows. vehicle: its geometry; nothing else is known of it."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._told: set[str] = set()

    def look(self, recording: Recording) -> list[str]:
        """What is new, one line each."""
        newest = _newest(recording)
        if not any(self._turns(name, table) for name, table in newest.nodes.items()):
            return []
        if min(float(table.t[-1] - table.t[0]) for table in newest.nodes.values() if len(table)) < _LEAST:
            return []
        try:
            result = find_gap(newest, assumed_model(newest, self._vehicle))
        except InputError as error:
            return self._new(str(error), f"gap: {error}")
        lines = []
        for finding in result.found:
            if not finding.effect.startswith(PREFIX) and _matters(finding, result):
                lines += self._new(f"{finding.effect} {finding.scope}", told(finding, result.model))
        return lines

    def _turns(self, name: str, table: Table) -> bool:
        mount = self._vehicle.nodes.get(name)
        if mount is None or mount.side is None or len(table) < 2:
            return False
        turning = np.abs(table["gz"][1:]) > _TURNS
        return float(np.sum(np.diff(table.t) * turning)) > _TURNING

    def _new(self, key: str, line: str) -> list[str]:
        if key in self._told:
            return []
        self._told.add(key)
        return [line]


def told(finding: Finding, model: Model) -> str:
    """A finding in one line, such as "left: the IMU sits 0.15 m off the hub"."""
    node = None if finding.scope in (ALL, VEHICLE) else finding.scope
    effect = next(it.effect for it in model.effects if (it.effect.name, it.node) == (finding.effect, node))
    place = {ALL: "all nodes", VEHICLE: "the vehicle"}.get(finding.scope, finding.scope)
    words = effect.describe()
    if not words:
        values = ", ".join(f"{name} {handy(it)}" for name, it in finding.parameters.items())
        words = f"{effect.meaning} ({values})"
    return f"{place}: {words}"


def _matters(finding: Finding, result: GapResult) -> bool:
    floor = result.gap.floor or 1.0
    excess = result.gap.before**2 - floor**2
    share = (finding.gap.before**2 - finding.gap.after**2) / excess if excess > 0.0 else 0.0
    return finding.confidence >= _SURE and share >= _SHARE


def _newest(recording: Recording) -> Recording:
    ends = [float(table.t[-1]) for table in recording.nodes.values() if len(table)]
    since = max(ends, default=0.0) - _NEWEST
    nodes = {}
    for name, table in recording.nodes.items():
        kept = table.t >= since
        nodes[name] = Table({column: table[column][kept] for column in table})
    return replace(recording, nodes=nodes, reference=None)
