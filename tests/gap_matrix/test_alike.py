"""Look-alikes: on its blunt log a pair is the same to any diagnosis, on an ordinary drive it is not."""

from dataclasses import replace

import numpy as np
import pytest

from gap_matrix import alike, cases, effects
from gap_matrix.dose import MEDIUM, STRONG, Meter

FREE = {"gyro_lag": ("time_constant",), "wheel_eccentricity": ("amplitude",)}


def told_apart_by(meter, hidden, other):
    """Nats by which the hidden effect stays ahead of the other one at its best.

    The other's channels are linear in its size.
    """
    zero = dict.fromkeys(other.parameters, 0.0)
    lasting = {key: other.parameters[key] for key in ("time_constant",) if other.name == "gyro_warmup"}
    units = [
        replace(other, parameters={**zero, **lasting, key: other.parameters[key] or 1e-3})
        for key in FREE.get(other.name, [key for key in other.parameters if key != "time_constant"])
    ]
    if other.name == "wheel_eccentricity":
        units.append(replace(units[0], parameters={**units[0].parameters, "phase": np.pi / 2}))
    nodes = [node for node in effects.SIDES if hidden.concerns(node) or other.concerns(node)]
    rows = {
        node: [
            meter.difference(node, one) if one.concerns(node) else np.zeros((len(meter.setup.taken[node]), 6))
            for one in (hidden, *units)
        ]
        for node in nodes
    }
    # The gain is a quadratic form: its matrix over the hidden effect and the units, by polarisation.
    count = len(units) + 1
    own = [sum(meter.gain_of(node, rows[node][i]) for node in nodes) for i in range(count)]
    size = [np.sqrt(MEDIUM / max(one, 1e-12)) for one in own]
    form = np.empty((count, count))
    for i in range(count):
        for j in range(i + 1):
            both = sum(
                meter.gain_of(node, size[i] * rows[node][i] + size[j] * rows[node][j]) for node in nodes
            )
            form[i, j] = form[j, i] = 0.5 * (both - size[i] ** 2 * own[i] - size[j] ** 2 * own[j])
    fitted = np.linalg.lstsq(form[1:, 1:], form[1:, 0], rcond=1e-9)[0]
    return float(form[0, 0] - form[1:, 0] @ fitted) / size[0] ** 2


@pytest.mark.parametrize("pair", alike.PAIRS, ids=lambda pair: pair.name)
def test_a_blunt_log_tells_a_pair_apart_by_less_than_a_nat_and_an_ordinary_drive_by_many(pair):
    meter = Meter(alike.blunt(801, pair, seconds=40.0), dead=pair.dead)
    hidden, _ = meter.dose(pair.one, MEDIUM)
    assert told_apart_by(meter, hidden, pair.other) < 1.0
    meter = Meter(cases.setup(801, duration=40.0))
    hidden, _ = meter.dose(cases.hidden_effect(meter.setup, pair.one.name, pair.one.scope), STRONG)
    assert told_apart_by(meter, hidden, pair.other) > 20.0
