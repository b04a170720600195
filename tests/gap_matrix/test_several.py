"""Several effects at once: found whichever of them comes first, and none beside them."""

from gap_matrix.judge import several, trials

SEED, STRANGER = 30_001, "accel_bias"


def test_the_names_at_the_end_are_the_same_whichever_is_forced_to_be_first(tmp_path):
    made = trials.trial(SEED, "several")
    hidden = {(it.name, it.scope) for it in made.hidden}
    assert len(hidden) >= 3
    made.write(tmp_path)
    weakest = min(made.hidden, key=made.meter.gain).name
    for first in (None, weakest, STRANGER):
        names = several.named_from(tmp_path, first)
        print(f"seed {SEED}, hidden {sorted(hidden)}; {first} first: {sorted(names)}")
        assert names == hidden
