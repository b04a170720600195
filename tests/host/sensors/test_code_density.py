"""Missing codes and uneven steps of a converter: named, and no noise term is given from them."""

import numpy as np
import pytest

from generators.odd_records import missing_codes as convert
from generators.odd_records import other_unit
from hubodo.sensors.allan.characterise import characterise_noise
from hubodo.sensors.code_density import count_codes, missing_codes, uneven_steps

COUNT, DT, SIGMA = 1 << 15, 0.02, 1e-3
T = np.arange(COUNT) * DT


def samples(seed):
    return SIGMA * np.random.default_rng(seed).standard_normal((COUNT, 3))


@pytest.mark.parametrize("step", [0.3, 1.0])
def test_an_ideal_converter_has_neither(step):
    for seed in range(5):
        values = step * SIGMA * np.rint(samples(seed)[:, 0] / (step * SIGMA))
        assert missing_codes(count_codes(values, step * SIGMA))[0] == 0
        assert uneven_steps(count_codes(values, step * SIGMA)) < 0.05


def test_a_code_that_never_occurs_is_missing_and_its_neighbour_wide():
    codes = np.rint(samples(1)[:, 0] / (0.5 * SIGMA))
    codes[codes == 2] = 3
    assert missing_codes(count_codes(0.5 * SIGMA * codes, 0.5 * SIGMA))[0] == 1
    edges = np.arange(-8.0, 9.0) + 0.3 * (np.arange(17) % 2)  # codes of 1.3 and 0.7 steps in turn
    codes = np.searchsorted(edges, samples(2)[:, 0] / (0.5 * SIGMA))
    assert uneven_steps(count_codes(0.5 * SIGMA * codes, 0.5 * SIGMA)) == pytest.approx(0.3, rel=0.3)


def test_no_noise_term_is_given_from_uneven_steps_or_of_two_sensors():
    rng = np.random.default_rng(3)
    for change, text in ((convert, "uneven"), (other_unit, "the scatter of the samples changes from")):
        _, gyro, _ = change(T, samples(4), None, rng, 2e-6)
        result = characterise_noise(T, gyro[:, 0], "gz")
        assert all(term.value is None for term in result.terms.values())
        assert any(text in note and "no noise term is given" in note for note in result.notes)
