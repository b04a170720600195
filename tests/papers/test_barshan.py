"""The comparison with Barshan and Durrant-Whyte can fail, and does where the model is wrong."""

from dataclasses import replace

import numpy as np

from hubodo.effects.warmup import WarmupModel
from papers import barshan

SEEDS = range(2)


def runs(scale):
    """Return errors as large as those of the paper, with sigmas too small by `scale`."""
    rng = np.random.default_rng(1)
    built = {direction: 7.0 * rng.normal(size=200) for direction in barshan.WAYS}
    built["mean of the rest"] = built["bound"] = built["ours"]
    return dict.fromkeys(barshan.PAPER, built | {"sigma": np.full(200, 7.0 / scale)})


def test_a_useful_model_passes_and_a_missing_or_wrong_one_is_reported():
    known = barshan.taught(0)
    long = barshan.hours(60.0, True, SEEDS, [known])
    assert barshan.judged(runs(1.0), long) == []
    without = barshan.hours(60.0, True, SEEDS, [barshan.Known(WarmupModel(0.0), {})])
    assert any("saves less than half" in line for line in barshan.judged(runs(1.0), without))
    backwards = replace(known, model=replace(known.model, c1=-known.model.c1))
    assert any(
        "half" in line for line in barshan.judged(runs(1.0), barshan.hours(60.0, True, SEEDS, [backwards]))
    )


def test_wrong_sigmas_and_paper_results_that_are_too_good_are_reported():
    long = {name: np.full((2, 3), value) for name, value in (("ours", 1.0), ("sigma", 1.0))}
    long["mean of the rest"] = np.full((2, 3), 100.0)
    assert any("sigma does not hold" in line for line in barshan.judged(runs(3.0), long))
    good = runs(1.0)
    for case in good:
        good[case] = good[case] | {"paper's filter": good[case]["paper's filter"] / 5.0}
    assert any("not near the paper" in line for line in barshan.judged(good, long))
