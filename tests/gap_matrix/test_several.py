"""Several hidden effects: all of them and no others are found, in any order of the search."""

import pytest

from gap_matrix.judge import several, trials
from repetitions import first_and_more

ABSENT_EFFECT = "accel_bias"


@pytest.mark.parametrize(
    ("kind", "seed", "least"), first_and_more(("single", 20_001, 1), ("several", 30_001, 3))
)
def test_an_absent_first_effect_is_removed_and_does_not_change_the_final_ones(kind, seed, least, tmp_path):
    """`make gap-several` begins with each of several effects."""
    trial = trials.draw_trial(seed, kind)
    hidden = {(it.name, it.scope) for it in trial.hidden}
    assert len(hidden) >= least
    trial.write(tmp_path)
    found_effects = several.search_names(tmp_path, ABSENT_EFFECT)
    print(f"seed {seed}, hidden {sorted(hidden)}; {ABSENT_EFFECT} first: {sorted(found_effects)}")
    assert found_effects == hidden


# 30019: an empirical term explains two effects at first and is removed by reconsideration.
# 30058: the gyro is quantized at three times its noise, which resembles neither lower noise nor a random
# walk.
@pytest.mark.repeat
@pytest.mark.parametrize("seed", [30_019, 30_058])
def test_a_term_that_explained_several_effects_is_removed(tmp_path, seed):
    trial = trials.draw_trial(seed, "several")
    hidden = {(it.name, it.scope) for it in trial.hidden}
    trial.write(tmp_path)
    found_effects = several.search_names(tmp_path)
    print(f"seed {seed}, hidden {sorted(hidden)}: {sorted(found_effects)}")
    assert found_effects == hidden
