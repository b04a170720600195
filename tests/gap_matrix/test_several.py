"""Several effects at once: found whichever of them comes first, and none beside them."""

import pytest

from gap_matrix.judge import several, trials

SEED, STRANGER = 30_001, "accel_bias"


def test_the_names_at_the_end_are_the_same_whichever_is_forced_to_be_first(tmp_path):
    made = trials.trial(SEED, "several")
    hidden = {(it.name, it.scope) for it in made.hidden}
    assert len(hidden) >= 3
    made.write(tmp_path)
    weakest = min(made.hidden, key=made.meter.gain).name
    for first in (weakest, STRANGER):
        names = several.named_from(tmp_path, first)
        print(f"seed {SEED}, hidden {sorted(hidden)}; {first} first: {sorted(names)}")
        assert names == hidden


# 30019: a term of a library came first, for two of them, and is looked at again beside all that came later.
# 30058: a gyro in steps three times its noise: rest between two of them is no precision, rounding no walk.
@pytest.mark.parametrize("seed", [30_019, 30_058])
def test_what_passed_for_others_together_leaves(tmp_path, seed):
    made = trials.trial(seed, "several")
    hidden = {(it.name, it.scope) for it in made.hidden}
    made.write(tmp_path)
    names = several.named_from(tmp_path)
    print(f"seed {seed}, hidden {sorted(hidden)}: {sorted(names)}")
    assert names == hidden
