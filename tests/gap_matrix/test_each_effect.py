"""Each effect, hidden in a short drive by the independent simulator, is the first that `gap` names."""

import numpy as np
import pytest

from gap_matrix import cases, effects, recording
from gap_matrix.dose import STRONG, Meter
from gap_matrix.make_case import write_case
from hubodo.effects import BY_NAME
from hubodo.gap.judge.search import SearchObserver, SearchResult, build_initial_state, search_effects
from hubodo.gap.problem.build import build_problem
from hubodo.gap.workflow import find_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

# A development seed, the shortest drive that the generator makes, and a third of the usual rate: a strong
# effect shows as much in it as in any other log, and it takes half a second.
SEED, SECONDS, RATE_HZ = 11, 33.0, 30.0
# In half a minute a walk may go where a warm-up would: it has to turn back first.
LONGER = {"gyro_rate_random_walk": 60.0}
LOST_S, LOST_RATE_HZ = 60.0, 50.0


class FoundOne(Exception):
    """A search has its first name, and need not go on."""


def first_named(folder):
    """(effect, scope) that a search adds first, None where it adds nothing: alone, it stays to the end."""

    def stop(found: SearchResult) -> None:
        raise FoundOne(found)

    problem = build_problem(read_folder(folder), read_model(folder / "model.toml"))
    try:
        search_effects(build_initial_state(problem), observer=SearchObserver(on_effect_added=stop))
    except FoundOne as it:
        (term,) = it.args[0].final.state.terms
        return term.key
    return None


def test_no_effect_is_left_out():
    assert sorted(effects.KINDS) == sorted(BY_NAME)
    assert SEED in effects.DEVELOPMENT_SEEDS


@pytest.mark.parametrize("name", effects.KINDS)
def test_an_effect_is_named_first(name, tmp_path):
    setup = cases.setup(SEED, duration=LONGER.get(name, SECONDS))
    setup = cases.sampled_at(setup, RATE_HZ, np.random.default_rng(SEED))
    hidden, nats = Meter(setup).dose(cases.hidden_effect(setup, name), STRONG)
    recording.write(setup, [hidden], tmp_path, {})
    named = first_named(tmp_path)
    print(f"seed {SEED}, {hidden.scope}: {dict(hidden.parameters)}, {nats:.0f} nats; named: {named}")
    assert named == (name, hidden.scope)


def test_a_wheel_that_is_lost_within_seconds_is_named_by_its_radius(tmp_path):
    """3 % of radius and a coarse reference: its angle, which both wheels' shared noise holds, runs away."""
    (hidden,) = write_case(
        tmp_path, 980, ["wheel_radius"], factor=10.0, duration=LOST_S, rate_hz=LOST_RATE_HZ, speed_noise=0.005
    )
    result = find_gap(read_folder(tmp_path), read_model(tmp_path / "model.toml"))
    assert [(it.effect, it.scope) for it in result.found] == [("wheel_radius", hidden.scope)]
