"""An effect whose estimates from parts of a log agree is named beside a drift of another sensor."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from hubodo.gap.workflow import find_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model
from hubodo.recording import Table

# Error of ax of the right node; drift of gx and gy of the left one: step in sigma, and decay per sample.
SCALE_ERROR, DRIFT_STEP, DRIFT_DECAY = 0.003, 0.4, 0.98


def name_effects(clean_log, scale_error, seed):
    recording, model = read_folder(clean_log), read_model(clean_log / "model.toml")
    left, right = (dict(recording.nodes[name].columns) for name in ("left", "right"))
    rng = np.random.default_rng(seed)
    for axis in ("gx", "gy"):
        drift = lfilter([1.0], [1.0, -DRIFT_DECAY], rng.standard_normal(len(left["t"])))
        left[axis] = left[axis] + DRIFT_STEP * model.noise.gyro * drift
    right["ax"] = right["ax"] * (1.0 + scale_error)
    drive = replace(recording, nodes={**recording.nodes, "left": Table(left), "right": Table(right)})
    result = find_gap(drive, model, reject=["empirical"])
    return [(one.effect, one.scope) for one in result.found], result.search.rounds[0].tempering


@pytest.mark.parametrize("seed", [11, 12])
def test_a_drift_of_one_gyro_does_not_hide_an_error_of_the_other_node(clean_log, seed):
    names, tempering = name_effects(clean_log, SCALE_ERROR, seed)
    print(f"seed {seed}: tempering {tempering:.1f}")
    assert names == [("accel_scale_factor", "right")]


@pytest.mark.parametrize("seed", [11, 12])
def test_a_drift_of_one_gyro_alone_is_no_effect_of_the_vehicle(clean_log, seed):
    names, tempering = name_effects(clean_log, 0.0, seed)
    print(f"seed {seed}: tempering {tempering:.1f}")
    assert names == []
