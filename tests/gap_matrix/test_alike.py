"""Confusable pairs: indistinguishable on their ambiguous log, distinguishable on an ordinary drive."""

from dataclasses import replace

import numpy as np
import pytest

from gap_matrix import alike, cases, effects
from gap_matrix.dose import MEDIUM_NATS, STRONG_NATS, GainMeter

FREE_PARAMETERS = {"gyro_lag": ("time_constant",), "wheel_eccentricity": ("amplitude",)}


def compute_advantage(meter, hidden, alternative):
    """Return the gain of the hidden effect over the best fit of the other one, in nats.

    The readings are linear in the parameters of the other effect.
    """
    zero = dict.fromkeys(alternative.parameters, 0.0)
    fixed = {
        key: alternative.parameters[key] for key in ("time_constant",) if alternative.name == "gyro_warmup"
    }
    unit_effects = [
        replace(alternative, parameters={**zero, **fixed, key: alternative.parameters[key] or 1e-3})
        for key in FREE_PARAMETERS.get(
            alternative.name, [key for key in alternative.parameters if key != "time_constant"]
        )
    ]
    if alternative.name == "wheel_eccentricity":
        unit_effects.append(
            replace(unit_effects[0], parameters={**unit_effects[0].parameters, "phase": np.pi / 2})
        )
    nodes = [node for node in effects.SIDES if hidden.applies_to(node) or alternative.applies_to(node)]
    differences = {
        node: [
            meter.reading_difference(node, effect)
            if effect.applies_to(node)
            else np.zeros((len(meter.setup.sample_times[node]), 6))
            for effect in (hidden, *unit_effects)
        ]
        for node in nodes
    }
    # The gain is a quadratic form; its matrix follows from gains of sums of differences (polarisation).
    count = len(unit_effects) + 1
    gains = [
        sum(meter.gain_of_difference(node, differences[node][i]) for node in nodes) for i in range(count)
    ]
    scales = [np.sqrt(MEDIUM_NATS / max(gain, 1e-12)) for gain in gains]
    gain_matrix = np.empty((count, count))
    for i in range(count):
        for j in range(i + 1):
            gain_of_sum = sum(
                meter.gain_of_difference(
                    node, scales[i] * differences[node][i] + scales[j] * differences[node][j]
                )
                for node in nodes
            )
            gain_matrix[i, j] = gain_matrix[j, i] = 0.5 * (
                gain_of_sum - scales[i] ** 2 * gains[i] - scales[j] ** 2 * gains[j]
            )
    fit = np.linalg.lstsq(gain_matrix[1:, 1:], gain_matrix[1:, 0], rcond=1e-9)[0]
    return float(gain_matrix[0, 0] - gain_matrix[1:, 0] @ fit) / scales[0] ** 2


@pytest.mark.parametrize("pair", alike.CONFUSABLE_PAIRS, ids=lambda pair: pair.name)
def test_a_pair_differs_by_less_than_a_nat_on_its_ambiguous_log_and_by_many_on_an_ordinary_drive(pair):
    meter = GainMeter(alike.draw_ambiguous_setup(801, pair, duration=40.0), dead_sensor=pair.dead_sensor)
    hidden, _ = meter.scale_to_gain(pair.first, MEDIUM_NATS)
    assert compute_advantage(meter, hidden, pair.second) < 1.0
    meter = GainMeter(cases.draw_setup(801, duration=40.0))
    hidden, _ = meter.scale_to_gain(
        cases.draw_hidden_effect(meter.setup, pair.first.name, pair.first.scope), STRONG_NATS
    )
    assert compute_advantage(meter, hidden, pair.second) > 20.0
