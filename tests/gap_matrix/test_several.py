"""Several hidden effects: all of them and no others are found, in any order of the search."""

import pytest

from gap_matrix.judge import several, trials
from repetitions import first_and_more

SEED, ABSENT_EFFECT = 30_001, "accel_bias"


@pytest.mark.repeat
def test_an_absent_first_effect_does_not_change_the_final_ones(tmp_path):
    """`make gap-several` begins with each of several effects."""
    trial = trials.draw_trial(SEED, "several")
    hidden = {(it.name, it.scope) for it in trial.hidden}
    assert len(hidden) >= 3
    trial.write(tmp_path)
    found_effects = several.search_names(tmp_path, ABSENT_EFFECT)
    print(f"seed {SEED}, hidden {sorted(hidden)}; {ABSENT_EFFECT} first: {sorted(found_effects)}")
    assert found_effects == hidden


# 30019: an empirical term explains two effects at first and is removed by reconsideration.
# 30058: the gyro is quantized at three times its noise, which resembles neither lower noise nor a random
# walk.
@pytest.mark.parametrize("seed", first_and_more(30_019, 30_058))
def test_a_term_that_explained_several_effects_is_removed(tmp_path, seed):
    trial = trials.draw_trial(seed, "several")
    hidden = {(it.name, it.scope) for it in trial.hidden}
    trial.write(tmp_path)
    found_effects = several.search_names(tmp_path)
    print(f"seed {seed}, hidden {sorted(hidden)}: {sorted(found_effects)}")
    assert found_effects == hidden
