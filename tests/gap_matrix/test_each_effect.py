"""Each effect, hidden in a short drive by the independent simulator, is the first one that `gap` finds."""

from functools import cache

import numpy as np
import pytest

from gap_matrix import cases, effects, recording
from gap_matrix.dose import STRONG_NATS, GainMeter
from gap_matrix.make_case import write_case
from hubodo.effects import BY_NAME
from hubodo.gap.judge.search import SearchObserver, SearchResult, build_initial_state, search_effects
from hubodo.gap.problem.build import build_problem
from hubodo.gap.workflow import find_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

# A development seed, the shortest drive of the generator, and a third of the usual rate: a strong effect has
# the same gain as in any other log, and the search takes half a second.
SEED, DURATION, RATE_HZ = 11, 33.0, 30.0
# In half a minute, a random walk may resemble a warm-up; a longer one does not.
DURATION_OF_EFFECT = {"gyro_rate_random_walk": 60.0}
LOST_PHASE_DURATION, LOST_PHASE_RATE_HZ = 60.0, 30.0


class FirstEffectFound(Exception):
    """A search has found its first effect and is stopped."""


def find_first_effect(folder):
    """Return effect and scope that a search adds first, or None."""

    def stop_search(result: SearchResult) -> None:
        raise FirstEffectFound(result)

    problem = build_problem(read_folder(folder), read_model(folder / "model.toml"))
    try:
        search_effects(build_initial_state(problem), observer=SearchObserver(on_effect_added=stop_search))
    except FirstEffectFound as interruption:
        (term,) = interruption.args[0].final.state.terms
        return term.key
    return None


def test_all_effects_of_the_package_are_simulated():
    # A banked road is a process along the path: test_gap_road_bank.py injects it by code of its own.
    fitted = [name for name, effect in BY_NAME.items() if effect.fitted_parameters()]
    assert sorted([*effects.KINDS, "road_bank"]) == sorted(fitted)
    assert SEED in effects.DEVELOPMENT_SEEDS


@cache
def draw_setup(duration):
    """Return the setup of a drive, and its meter."""
    setup = cases.draw_setup(SEED, duration=duration)
    setup = cases.resample_nodes(setup, RATE_HZ, np.random.default_rng(SEED))
    return setup, GainMeter(setup)


@pytest.mark.parametrize("name", effects.KINDS)
def test_a_hidden_effect_is_found_first(name, tmp_path):
    setup, meter = draw_setup(DURATION_OF_EFFECT.get(name, DURATION))
    hidden, nats = meter.scale_to_gain(cases.draw_hidden_effect(setup, name), STRONG_NATS)
    recording.write_case_files(setup, [hidden], tmp_path, {})
    finding = find_first_effect(tmp_path)
    print(f"seed {SEED}, {hidden.scope}: {dict(hidden.parameters)}, {nats:.0f} nats; named: {finding}")
    assert finding == (name, hidden.scope)


def test_a_radius_error_that_loses_the_wheel_phase_is_found(tmp_path):
    """A radius error of 3 % exceeds the process noise of the phase, which diverges within seconds."""
    (hidden,) = write_case(
        tmp_path,
        980,
        ["wheel_radius"],
        factor=10.0,
        duration=LOST_PHASE_DURATION,
        rate_hz=LOST_PHASE_RATE_HZ,
        speed_noise=0.005,
    )
    result = find_gap(read_folder(tmp_path), read_model(tmp_path / "model.toml"))
    assert [(interruption.effect, interruption.scope) for interruption in result.found] == [
        ("wheel_radius", hidden.scope)
    ]
